"""Arbitration between frames that start together, and collisions of frames with one identifier."""

import numpy as np
import numpy.typing as npt

from dbc.frame import EXTENDED, REMOTE, Frames


def arbitration_keys(burst: Frames) -> npt.NDArray[np.int64]:
    """Return the arbitration key of each frame: the frame with the lowest key wins.

    32 bits in bus order (ISO 11898-1): base identifier 11, RTR or SRR 1, IDE 1, extension 18, RTR 1.
    So a standard frame beats an extended one with the same base, and data beats remote.
    """
    can_id = burst["can_id"].astype(np.int64)
    remote = (burst["flags"] & REMOTE != 0).astype(np.int64)
    standard = (can_id & 0x7FF) << 21 | remote << 20
    extended = (can_id >> 18 & 0x7FF) << 21 | 3 << 19 | (can_id & 0x3FFFF) << 1 | remote
    keys: npt.NDArray[np.int64] = np.where(burst["flags"] & EXTENDED != 0, extended, standard)
    return keys


def clash_bits(same: Frames) -> int | None:
    """Return the approximate number of bits until frames with one identifier differ, None for equal frames."""
    first = same[0]
    if (same["length"] != first["length"]).any() or (same["flags"] != first["flags"]).any():
        return 19
    differs = (same["data"] != first["data"]).any(axis=0)
    return 19 + 8 * int(differs.argmax()) if differs.any() else None
