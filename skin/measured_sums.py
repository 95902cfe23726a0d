"""Decoding of a `Measurement`: checks it, decodes it, and logs refused measurements."""

import time
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from skin.errors import InputError
from skin.measurement import Sbhe
from skin.messages import Measurement
from skin.service import say

#: Shortest time between two log lines about refused measurements.
COMPLAINT_PERIOD_S: Final = 10.0


class MeasuredSums(NamedTuple):
    """The sums of one cycle.

    Attributes
    ----------
    counts : array of int32, shape (m,)
        Sums in ADC counts; read-only.
    valid : array of bool, shape (blocks,)
        True if every sum of the block came in this cycle.
    """

    counts: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]


def decode_measurement(measurement: Measurement, phi: Sbhe) -> MeasuredSums:
    """Return the sums of a measurement with Φ.

    Raises
    ------
    InputError
        If the sums were measured with another Φ, or sums or validity have another length.
    """
    if measurement.fingerprint != phi.fingerprint:
        came = measurement.fingerprint[:32]
        raise InputError(f"measured with Φ {came!r}, expected {phi.fingerprint}: give both ends the same --layout")
    lengths = (len(measurement.sums), len(measurement.valid))
    expected = (4 * phi.shape[0], phi.blocks)
    if lengths != expected:
        raise InputError(
            f"sums and validity of {lengths[0]} and {lengths[1]} bytes, expected {expected[0]} and {expected[1]}"
        )
    return MeasuredSums(np.frombuffer(measurement.sums, "<i4"), np.frombuffer(measurement.valid, np.uint8) != 0)


class MeasurementReader:
    """Decodes the measurements that a service receives; measurements that do not fit are counted and logged.

    Parameters
    ----------
    phi : Sbhe
        The service's Φ.
    service : str
        Name of the service in the log lines.

    Attributes
    ----------
    refused : int
        Measurements that did not fit.
    """

    def __init__(self, phi: Sbhe, service: str) -> None:
        self.refused = 0
        self._phi = phi
        self._service = service
        self._quiet_until_s = float("-inf")

    def read(self, measurement: Measurement) -> MeasuredSums | None:
        """Return the sums of a measurement, or None if they do not fit."""
        try:
            return decode_measurement(measurement, self._phi)
        except InputError as error:
            self.refused += 1
            now_s = time.monotonic()
            if now_s >= self._quiet_until_s:
                self._quiet_until_s = now_s + COMPLAINT_PERIOD_S
                say(self._service, f"measurement refused ({self.refused} so far): {error}")
            return None
