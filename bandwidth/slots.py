"""How long frames of boards with slots wait at worst, when every board sends in every slot.

Each board has a place of its own in the slot, and queues its frame within a jitter after that. A busy time begins with
the frame of some board that was queued last, behind the longest frame of lower priority, and all frames that it meets
were queued as late as it, or as they come. So the wait of a frame is the longest over all busy times that can reach the
frame, which begin with any frame of at least its priority in its slot or in those before. As in `bandwidth.response`,
the frame begins when none of higher priority is left. A board whose frame still waits leaves its next slot out.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bandwidth.response import (
    BIT,
    ERROR_BITS,
    ERROR_FRAME,
    ERROR_INTERVAL,
    JITTER,
    PERIOD,
    TIME,
    UNBOUNDED,
    Nanoseconds,
    arrivals,
)
from bandwidth.traffic import Disturbance, Traffic
from dbc.contract import Contract
from dbc.dictionary import slot_offset_us
from dbc.frame_bits import nominal_ns
from shell.compiled import njit

#: A busy time of so many slots has no end.
_SLOTS_MAX: Final = 100


def slot_responses_ns(
    contract: Contract, streams: Traffic, time_ns: npt.NDArray[np.integer], allowed: Disturbance
) -> Nanoseconds:
    """Bound the time from the sample to the end of each TPDO, shape (TPDOs,), in the order of `streams`.

    Parameters
    ----------
    time_ns : array of int, shape (n,)
        Of each stream, intermission included: the longest, or the mean.
    """
    offset_of = {tpdo.cob_id: slot_offset_us(contract, node) for node in contract.nodes for tpdo in node.tpdos}
    places, slot_ns = np.flatnonzero(streams.is_tpdo), round(contract.layout.steps.slot_s * 1e9)
    offset = np.array([1000 * offset_of[int(each)] for each in streams.frames["can_id"][places]], np.int64)
    period, jitter = (np.rint(each * 1e9).astype(np.int64) for each in (streams.period_s, streams.jitter_s))
    others = np.flatnonzero(~streams.is_tpdo)
    rows = np.stack([time_ns, period, jitter], axis=1).astype(np.int64)
    bit_ns, interval_ns = nominal_ns(1, streams.bus.bitrate), round(1e9 / (allowed.errors_per_s or np.inf))
    wire = np.array([bit_ns, ERROR_BITS * bit_ns, interval_ns], np.int64)
    queued_ns = round((allowed.of(contract.layout).jitter_s or 0.0) * 1e9)
    found = np.empty(len(places), np.int64)
    for place, stream in enumerate(places.tolist()):
        above, behind = rows[others[others < stream]], rows[stream + 1 :, 0]
        blocked = int(behind.max(initial=0))
        waits = _longest(place, rows[places, 0], offset, slot_ns, int(jitter[stream]), above, blocked, wire)
        found[place] = waits if waits == UNBOUNDED else queued_ns + waits
    return found


@njit(cache=True, nogil=True)
def _longest(  # noqa: PLR0917  compiled functions take no keywords
    frame: int, time: Any, offset: Any, slot: int, jitter: int, above: Any, blocked: int, wire: Any
) -> int:
    """Return the longest time from the queueing of a frame to its end; `time` and `offset` are by falling priority."""
    longest = 0
    for back in range(_SLOTS_MAX):
        reaches = False
        for first in range(frame + 1):
            begun = offset[first] - back * slot + jitter
            if begun > offset[frame] + jitter:
                continue
            wait = _wait(begun, frame, time, offset, slot, jitter, above, blocked, wire)
            if wait == UNBOUNDED:
                return UNBOUNDED
            if begun + wait >= offset[frame]:
                reaches = True
                longest = max(longest, begun + wait + time[frame] - max(begun, offset[frame]))
        if not reaches:
            return longest
    return UNBOUNDED


@njit(cache=True, nogil=True)
def _wait(  # noqa: PLR0917  compiled functions take no keywords
    begun: int, frame: int, time: Any, offset: Any, slot: int, jitter: int, above: Any, blocked: int, wire: Any
) -> int:
    """Return how long frames of higher priority than a frame are left after `begun`."""
    wait, before, error = blocked, -1, wire[ERROR_FRAME] + max(time[: frame + 1].max(), blocked)
    while wait != before:
        before, wait = wait, blocked
        if wire[ERROR_INTERVAL]:
            wait += arrivals(before + time[frame], 0, wire[ERROR_INTERVAL]) * error
        for row in range(len(above)):
            wait += arrivals(before + wire[BIT], above[row, JITTER], above[row, PERIOD]) * above[row, TIME]
        for other in range(frame):
            # Slots of the other board that begin from the earliest to now.
            until = begun + before + wire[BIT] - offset[other]
            wait += (-(-until // slot) + (offset[other] - begun + jitter) // slot) * time[other]
        if wait > _SLOTS_MAX * slot:
            return UNBOUNDED
    return int(wait)
