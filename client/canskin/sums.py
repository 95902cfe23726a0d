"""The sums in a measurement."""

import numpy as np
import numpy.typing as npt

from canskin.messages import Measurement


def corrected_counts(measurement: Measurement, valid_sums: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """Return the sums of a synchronous measurement less their offsets, 0 if not valid, ADC counts, shape (m,)."""
    counts = np.frombuffer(measurement.sums, "<i4")
    if measurement.offsets:
        counts = counts - np.frombuffer(measurement.offsets, "<i4")
        counts[~valid_sums] = 0
    elif measurement.usable:
        counts = np.where(valid_sums, counts, 0)
    return counts
