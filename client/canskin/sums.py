"""The sums in a measurement, and the taxels that are in doubt."""

from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import Image, Measurement

_MOST_COUNTS: Final = np.iinfo(np.int32).max


def corrected_counts(measurement: Measurement, valid_sums: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """Return the sums of a measurement less their offsets, 0 if not valid, ADC counts, shape (m,).

    Raise InputError if they do not fit int32.
    """
    counts = np.frombuffer(measurement.sums, "<i4")
    if measurement.offsets:
        wide = counts.astype(np.int64) - np.frombuffer(measurement.offsets, "<i4")
        if np.abs(wide).max() > _MOST_COUNTS:
            raise InputError(f"sums less offsets beyond {_MOST_COUNTS} counts")
        counts = wide.astype(np.int32)
    corrected = counts * valid_sums
    corrected.flags.writeable = False
    return corrected


def doubtful_taxels(message: Measurement | Image, taxels: int) -> npt.NDArray[np.bool_] | None:
    """Return the taxels whose force may be an error of the zero, row-major, shape (n,); None if none is doubtful."""
    if not message.doubtful:
        return None
    if len(message.doubtful) != (taxels + 7) // 8:
        raise InputError(f"doubtful of {len(message.doubtful)} bytes, expected {(taxels + 7) // 8}, or none")
    return np.unpackbits(np.frombuffer(message.doubtful, np.uint8), count=taxels).view(np.bool_)
