"""TIME (CiA 301, 7.2.6): the wall clock, broadcast to all nodes."""

from typing import Final

from dbc.canopen import TIME_COB_ID
from dbc.frame import Frames, one_frame

#: Days from 1970-01-01 to 1984-01-01, where TIME_OF_DAY begins.
_DAYS_TO_1984: Final = 5113
_DAY_MS: Final = 86_400_000


def time_of_day(wall_ns: int) -> bytes:
    """Return TIME_OF_DAY (CiA 301, 7.1.6.5): 28 bits milliseconds after midnight, 4 bits 0, 16 bits days since 1984.

    Parameters
    ----------
    wall_ns : int
        Nanoseconds since 1970-01-01 UTC. Midnight and days are those of UTC.
    """
    days, after_midnight_ms = divmod(wall_ns // 1_000_000, _DAY_MS)
    return after_midnight_ms.to_bytes(4, "little") + ((days - _DAYS_TO_1984) & 0xFFFF).to_bytes(2, "little")


def time_frame(wall_ns: int) -> Frames:
    """Return the TIME frame of an instant."""
    return one_frame(TIME_COB_ID, time_of_day(wall_ns))
