"""Arbitration, compiled: which of the waiting frames wins the bus, and when each frame ends."""

from heapq import heappop, heappush
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from dbc.frame import CAN_ID_AT, ECHO, ERROR, EXPIRES_AT, EXTENDED, FLAGS_AT, FRAME, REMOTE, TIME_AT, Frames
from shell.compiled import njit

#: A frame in a transmit queue: its arbitration key, of which the lowest wins, its number, earliest start, time on the
#: bus, and the number of its station.
QUEUED: Final = np.dtype(
    [
        ("frame", FRAME),
        ("key", "<i8"),
        ("sequence", "<i8"),
        ("release_ns", "<i8"),
        ("duration_ns", "<i8"),
        ("station", "<i8"),
    ]
)
#: Receivers of a record: all other stations, the station that sent the frame, or both.
OTHERS: Final = 1
OWNER: Final = 2
#: Flags of a frame that left its transmit queue unsent.
DISCARDED: Final = ECHO | ERROR
#: Release of a frame that waits until `TransmitQueues.unpark`, and the latest time up to which frames are sent.
PARKED_NS: Final = (1 << 63) - 1
FOREVER_NS: Final = PARKED_NS - 1

Words = npt.NDArray[np.int64]
#: Frames that wait: an array of QUEUED.
Queued = npt.NDArray[np.void]

#: A record that ended on the bus is a row of 64 bits: the frame, the number of the station that sent the frame or
#: receives the report, and who gets the record.
FRAME_WORDS: Final = FRAME.itemsize // 8
TIME, EXPIRES, OWNED_BY, AUDIENCE, EVENT_WORDS = TIME_AT // 8, EXPIRES_AT // 8, *range(FRAME_WORDS, FRAME_WORDS + 3)
# Compiled code reads waiting frames as such rows, too.
_KEY, _SEQUENCE, _RELEASE, _DURATION, _STATION, _QUEUED = range(FRAME_WORDS, FRAME_WORDS + 6)
_HEAD: Final = CAN_ID_AT // 8
_FLAGS: Final = 8 * (FLAGS_AT - CAN_ID_AT)


def words(records: npt.NDArray[np.void]) -> Words:
    """Return records as rows of 64 bits; a view where possible."""
    return np.ndarray((len(records), records.itemsize // 8), np.int64, np.ascontiguousarray(records))


def queued_frames(burst: Frames, durations_ns: Words, now_ns: int, sequence: int, station: int) -> Queued:
    """Return frames as they wait in transmit queues, numbered from `sequence` on.

    Parameters
    ----------
    durations_ns : array of int64, shape (n,)
        Time of each frame on the bus.
    now_ns : int
        Release of frames without one. A release in the past is kept if the bus has been idle since: a sender that the
        host delayed is then as punctual on the bus as hardware would be.
    """
    return np.ndarray(len(burst), QUEUED, _queue(words(burst), durations_ns, now_ns, sequence, station))


@njit(cache=True, nogil=True)
def _queue(burst: Words, durations_ns: Words, now_ns: int, sequence: int, station: int) -> Words:
    """Return rows of QUEUED.

    A key is 32 bits in bus order (ISO 11898-1): base identifier 11, RTR or SRR 1, IDE 1, extension 18, RTR 1.
    So a standard frame beats an extended one with the same base, and data beats remote.
    """
    queued = np.empty((len(burst), _QUEUED), np.int64)
    for place in range(len(burst)):
        row, head = queued[place], burst[place, _HEAD]
        row[:FRAME_WORDS] = burst[place]
        can_id, flags = head & 0xFFFFFFFF, head >> _FLAGS & 0xFF
        remote = np.int64(flags & REMOTE != 0)
        if flags & EXTENDED:
            row[_KEY] = (can_id >> 18 & 0x7FF) << 21 | 3 << 19 | (can_id & 0x3FFFF) << 1 | remote
        else:
            row[_KEY] = (can_id & 0x7FF) << 21 | remote << 20
        row[_SEQUENCE], row[_STATION] = sequence + place, station
        row[_RELEASE] = burst[place, TIME] if burst[place, TIME] > 0 else now_ns
        row[_DURATION] = durations_ns[place]
    return queued


@njit(cache=True, nogil=True)
def carry(queued: Words, free_ns: int, until_ns: int, intermission_ns: int, sends: bool) -> tuple[Any, ...]:
    """Send the frames that begin up to `until_ns`, in the order of arbitration; give back those that have expired.

    Parameters
    ----------
    queued : array of int64, shape (n, words of QUEUED)
        Ascending by release; changed.
    free_ns : int
        When the bus is idle.
    sends : bool
        Whether nothing can go wrong. Else, and where another frame has the identifier of the winner, the arbitration
        ends with the winner, which waits on.

    Returns
    -------
    left : array of int64, shape (n', words of QUEUED)
        Frames that wait on.
    ended : array of int64, shape (events, EVENT_WORDS)
        Ascending by time.
    sent, busy_ns : int
        Number of frames among them that were sent, and their time on the bus.
    free_ns, start_ns : int
        When the bus is idle again, and start of the winner that waits.
    winner : int
        Its place in `left`, below 0 without one.
    """
    ended, is_gone = np.empty((len(queued), EVENT_WORDS), np.int64), np.zeros(len(queued), np.bool_)
    ready = [(queued[0, _KEY], queued[0, _SEQUENCE], 0) for _ in range(0)]
    count = sent = busy_ns = coming = start_ns = 0
    winner, expiry_ns = -1, PARKED_NS
    while ready or coming < len(queued):
        start_ns = free_ns if ready else max(free_ns, queued[coming, _RELEASE])
        if start_ns > until_ns:
            break
        while coming < len(queued) and queued[coming, _RELEASE] <= start_ns:
            heappush(ready, (queued[coming, _KEY], queued[coming, _SEQUENCE], coming))
            if queued[coming, EXPIRES] > 0:
                expiry_ns = min(expiry_ns, queued[coming, EXPIRES])
            coming += 1
        if start_ns > expiry_ns:  # however urgent the others are
            ready, expiry_ns, count = _expire(ready, queued, start_ns, is_gone, ended, count)
            continue
        key, _, place = heappop(ready)
        if not sends or (ready and ready[0][0] == key):
            winner = place
            break
        free_ns = start_ns + queued[place, _DURATION]
        _end(queued[place], free_ns - intermission_ns, OTHERS | OWNER, ended[count])
        is_gone[place] = True
        count += 1
        sent += 1
        busy_ns += queued[place, _DURATION]
    first = coming  # of those that wait on: what has not been released stays where it is
    for place in range(coming - 1, -1, -1):
        if not is_gone[place]:
            first -= 1
            queued[first] = queued[place]
            winner = first if place == winner else winner
    return queued[first:], ended[:count], sent, busy_ns, free_ns, start_ns, winner - first


@njit(cache=True, nogil=True)
def _expire(  # noqa: PLR0917  compiled functions take no keywords
    ready: list[tuple[int, int, int]], queued: Words, start_ns: int, is_gone: Any, ended: Words, count: int
) -> tuple[list[tuple[int, int, int]], int, int]:
    """Give back the frames of a heap that have expired; return the others, when the next expires, and `count`."""
    kept, next_ns = ready[:0], PARKED_NS
    while ready:
        each = heappop(ready)
        expires_ns = queued[each[2], EXPIRES]
        if 0 < expires_ns < start_ns:
            _end(queued[each[2]], start_ns, OWNER, ended[count])
            ended[count, _HEAD] |= DISCARDED << _FLAGS
            is_gone[each[2]] = True
            count += 1
        else:
            kept.append(each)  # ascending, so this is a heap
            next_ns = min(next_ns, expires_ns) if expires_ns > 0 else next_ns
    return kept, next_ns, count


@njit(cache=True, nogil=True)
def _end(queued: Words, time_ns: int, audience: int, event: Words) -> None:
    """Write the record of a frame; its latest start matters to the sender only."""
    event[:FRAME_WORDS] = queued[:FRAME_WORDS]
    event[TIME], event[EXPIRES], event[OWNED_BY], event[AUDIENCE] = time_ns, 0, queued[_STATION], audience


def clash_bits(same: Frames) -> int | None:
    """Return the approximate number of bits until frames with one identifier differ, None for equal frames."""
    first = same[0]
    if (same["length"] != first["length"]).any() or (same["flags"] != first["flags"]).any():
        return 19
    differs = (same["data"] != first["data"]).any(axis=0)
    return 19 + 8 * int(differs.argmax()) if differs.any() else None
