"""Decoding of a `Measurement`: checks it, decodes it, and logs refused measurements."""

import math
import time
from collections.abc import Callable
from typing import Final, Generic, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError, tell
from canskin.messages import (
    BlockState,
    CycleMeasurement,
    Measurement,
    SteppedMeasurement,
)
from canskin.sums import corrected_counts, doubtful_taxels
from canskin.text import plain
from skin.phi import Phi

#: Shortest time between two log lines about refused measurements.
COMPLAINT_PERIOD_S: Final = 10.0
#: Looked up once: members of an enumeration take as long as arithmetic on an array of blocks.
_HIGHEST_STATE, _QUIET = int(max(BlockState)), int(BlockState.QUIET)


class MeasuredSums(NamedTuple):
    """The sums of one cycle.

    Attributes
    ----------
    counts : array of int32, shape (m,)
        Sums less their offsets in ADC counts; 0 if not valid; read-only.
    valid : array of bool, shape (blocks,)
        True if every sum of the block came in this cycle, and all are usable.
    valid_sums : array of bool, shape (m,)
        True if the sum came in this cycle, and is usable.
    cycle : int
        Number of the cycle, from 1: it tells the Φ that changes from frame to frame.
    """

    counts: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]
    valid_sums: npt.NDArray[np.bool_]
    cycle: int = 1


class SteppedSums(NamedTuple):
    """The newest sums of a skin with steps.

    Attributes
    ----------
    counts : array of int32, shape (m,)
        Sums less their offsets in ADC counts; 0 if unknown; read-only.
    valid : array of bool, shape (blocks,)
        True if all sums of the block are known, current and usable.
    known : array of bool, shape (m,)
        True if a value of the sum is held, and is usable.
    noise_n : float
        Median of the nodes' noise, newtons; 0 if it is not known.
    """

    counts: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]
    known: npt.NDArray[np.bool_]
    noise_n: float


Sums = TypeVar("Sums", bound=MeasuredSums | SteppedSums)
Kind = TypeVar("Kind", bound=Measurement)


def decode_measurement(measurement: Measurement, phi: Phi) -> MeasuredSums:
    """Return the sums of the measurement of a cycle with Φ."""
    check_measurement(measurement, phi, CycleMeasurement)
    valid_sums = used_sums(measurement, phi)
    counts = corrected_counts(measurement, valid_sums)
    return MeasuredSums(counts, used_blocks(measurement, phi), valid_sums, measurement.cycle)


def used_sums(measurement: Measurement, phi: Phi) -> npt.NDArray[np.bool_]:
    """Return which sums came and are usable, shape (m,)."""
    valid_sums = phi.sums_of_blocks(np.frombuffer(measurement.valid, np.uint8) != 0)
    if measurement.usable:
        valid_sums &= np.frombuffer(measurement.usable, np.uint8) != 0
    return valid_sums


def used_blocks(measurement: Measurement, phi: Phi) -> npt.NDArray[np.bool_]:
    """Return which blocks came with sums that are all usable, shape (blocks,)."""
    valid: npt.NDArray[np.bool_] = np.frombuffer(measurement.valid, np.uint8) != 0
    if measurement.usable:
        valid &= phi.all_of_blocks(np.frombuffer(measurement.usable, np.uint8) != 0)
    return valid


def decode_stepped(measurement: Measurement, phi: Phi) -> SteppedSums:
    """Return the sums of a stepped measurement with Φ."""
    measurement = check_measurement(measurement, phi, SteppedMeasurement)
    if not (math.isfinite(measurement.noise_n) and measurement.noise_n >= 0):
        raise InputError(f"noise_n of {measurement.noise_n}, expected a number of 0 or more")
    known, valid = (np.frombuffer(each, np.uint8) != 0 for each in (measurement.known, measurement.valid))
    states = np.frombuffer(measurement.states, np.uint8)
    if states.max() > _HIGHEST_STATE:
        raise InputError(f"a block's state is {states.max()}, expected 0 to {_HIGHEST_STATE}")
    if not known.all() and not phi.all_of_blocks(known)[valid].all():
        raise InputError("a block is valid, but not all its sums are known")
    if (valid & (states < _QUIET)).any():
        raise InputError("a block is valid, but neither fresh nor quiet")
    if measurement.usable:
        known = known & (np.frombuffer(measurement.usable, np.uint8) != 0)
    return SteppedSums(corrected_counts(measurement, known), used_blocks(measurement, phi), known, measurement.noise_n)


def check_measurement(measurement: Measurement, phi: Phi, kind: type[Kind]) -> Kind:
    """Return a measurement that was checked: its kind, Φ and the lengths of its arrays.

    Parameters
    ----------
    phi : Phi
        Φ of its sums.
    kind : type
        `CycleMeasurement`, `SteppedMeasurement`, or `Measurement` for both.
    """
    check_fingerprint(measurement.fingerprint, phi)
    if not isinstance(measurement, kind):
        came, wanted = (each.__struct_config__.tag for each in (type(measurement), kind))
        raise InputError(f"a measurement of {came} sending, expected {wanted}: give both ends the same --layout")
    sums, blocks = phi.shape[0], phi.blocks
    lengths = {"sums": 4 * sums, "valid": blocks}
    if isinstance(measurement, SteppedMeasurement):
        lengths |= {"known": sums, "states": blocks, "since_ns": 8 * blocks}
    for name, expected in lengths.items():
        if (length := len(getattr(measurement, name))) != expected:
            raise InputError(f"{name} of {length} bytes, expected {expected}")
    for name, expected in (("offsets", 4 * sums), ("usable", sums)):
        if (length := len(getattr(measurement, name))) not in {0, expected}:
            raise InputError(f"{name} of {length} bytes, expected {expected}, or none")
    doubtful_taxels(measurement, phi.shape[1])
    return measurement


def check_fingerprint(fingerprint: str, phi: Phi) -> None:
    """Check that sums were measured with Φ."""
    if fingerprint != phi.fingerprint:
        raise InputError(
            f"measured with Φ '{plain(fingerprint[:32])}', expected {phi.fingerprint}: give both ends the same --layout"
        )


class MeasurementReader(Generic[Sums]):
    """Decodes the measurements that a service receives; measurements that do not fit are counted and logged.

    Parameters
    ----------
    phi : Phi
        The service's Φ.
    service : str
        Name of the service in the log lines.
    decode : callable
        `decode_measurement` or `decode_stepped`.

    Attributes
    ----------
    refused : int
        Measurements that did not fit.
    """

    def __init__(self, phi: Phi, service: str, decode: Callable[[Measurement, Phi], Sums]) -> None:
        self.refused = 0
        self._phi = phi
        self._service = service
        self._decode = decode
        self._quiet_until_s = float("-inf")

    def read(self, measurement: Measurement) -> Sums | None:
        """Return the sums of a measurement, or None if they do not fit."""
        try:
            return self._decode(measurement, self._phi)
        except InputError as error:
            self.refused += 1
            now_s = time.monotonic()
            if now_s >= self._quiet_until_s:
                self._quiet_until_s = now_s + COMPLAINT_PERIOD_S
                tell(self._service, f"measurement refused ({self.refused} so far): {error}")
            return None
