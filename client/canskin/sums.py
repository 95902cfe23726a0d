"""The sums in a measurement."""

from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import Measurement

_MOST_COUNTS: Final = np.iinfo(np.int32).max


def corrected_counts(measurement: Measurement, valid_sums: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """Return the sums of a synchronous measurement less their offsets, 0 if not valid, ADC counts, shape (m,).

    Raises
    ------
    InputError
        If sums less offsets do not fit int32.
    """
    counts = np.frombuffer(measurement.sums, "<i4")
    if measurement.offsets:
        wide = counts.astype(np.int64) - np.frombuffer(measurement.offsets, "<i4")
        if np.abs(wide).max() > _MOST_COUNTS:
            raise InputError(f"sums less offsets beyond {_MOST_COUNTS} counts")
        counts = wide.astype(np.int32)
    corrected = np.where(valid_sums, counts, np.int32(0))
    corrected.flags.writeable = False
    return corrected
