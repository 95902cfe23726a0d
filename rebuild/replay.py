"""A CAN log, decoded by the collector of the gateway."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.canopen import SYNC_COB_ID
from dbc.contract import SYNC_OVERFLOW, Contract, next_counter
from dbc.frame import ECHO, ERROR, EXTENDED, FD, REMOTE, Frames
from gateway.collector import Collector
from rebuild.cycles import Cycles
from skin.errors import InputError
from skin.messages import FrameCounts

#: In a log, a late SYNC of one bus may come after the next SYNC of another bus, but not later.
_CYCLES_IN_FLIGHT: Final = 2


@dataclass
class _Cycle:
    """One cycle of the log: its SYNC counter, the time of its first SYNC, and its frames on every bus."""

    counter: int
    time_ns: int
    frames: dict[int, Frames] = field(default_factory=dict)


def replay(
    contract: Contract, logged: Mapping[int, Frames], advance: Callable[[int], None]
) -> tuple[Cycles, FrameCounts]:
    """Return the cycles of a log, and how its frames were counted.

    On each bus a cycle begins with its SYNC and ends with the next SYNC. Every node counts as proven, because a log
    does not tell the Φ of its nodes.

    Parameters
    ----------
    contract : Contract
    logged : mapping of int to Frames
        Frames by the number of their bus, in the order of the log.
    advance : callable
        Called with the number of further decoded cycles.

    Raises
    ------
    InputError
        If the log holds no SYNC as the layout has it.
    """
    found = _cycles(contract, logged)
    if not found:
        identity = contract.layout.sync.identity
        length = "without data" if identity == "window" else "with a counter, 1 byte"
        raise InputError(
            f'the log holds no SYNC {length} (COB-ID {SYNC_COB_ID:02X}h, sync.identity = "{identity}" of the layout): '
            "it cannot be cut into cycles"
        )
    collector = Collector(contract)
    phi = contract.phi
    collector.trust(slice(0, phi.blocks), proven=True)
    counts = np.empty((len(found), phi.shape[0]), np.int32)
    valid = np.empty((len(found), phi.blocks), np.bool_)
    for number, cycle in enumerate(found):
        collector.open(cycle.counter, cycle.time_ns)
        for bus, arrived in cycle.frames.items():
            collector.take(bus, arrived)
        gathered = collector.close(cycle.counter)
        counts[number], valid[number] = gathered.sums, gathered.valid
        advance(1)
    return Cycles(counts, valid, np.array([cycle.time_ns for cycle in found], np.int64)), collector.counts


def _cycles(contract: Contract, logged: Mapping[int, Frames]) -> list[_Cycle]:
    """Join the parts of all buses that belong to one SYNC: by its counter or, without counter, by its time."""
    is_counted = contract.sync_overflow > 0
    near_ns = contract.layout.sync.period_s * 1e9 / 2
    parts = [(int(part["time_ns"][0]), bus, part) for bus, seen in logged.items() for part in _parts(seen, is_counted)]
    parts.sort(key=lambda part: part[:2])
    found: list[_Cycle] = []
    for time_ns, bus, part in parts:
        counter = int(part["data"][0, 0])
        for cycle in found[-_CYCLES_IN_FLIGHT:]:
            is_same = cycle.counter == counter if is_counted else time_ns - cycle.time_ns < near_ns
            if is_same and bus not in cycle.frames:
                cycle.frames[bus] = part
                break
        else:
            counter = counter or (next_counter(found[-1].counter) if found else 1)
            found.append(_Cycle(counter, time_ns, {bus: part}))
    return found


def _parts(seen: Frames, is_counted: bool) -> list[Frames]:
    """Split the frames of a bus at every SYNC; frames before the first SYNC are left out.

    The SYNCs are marked as echoes, like in the gateway that sent them.
    """
    plain = seen["flags"] & (EXTENDED | REMOTE | ERROR | FD) == 0
    is_sync = plain & (seen["can_id"] == SYNC_COB_ID) & (seen["length"] == int(is_counted))
    if is_counted:
        is_sync &= _in_range(seen["data"][:, 0])
    marked = seen.copy()
    marked["flags"][is_sync] |= ECHO
    places = np.flatnonzero(is_sync)
    return np.split(marked, places)[1:] if len(places) else []


def _in_range(counter: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    return (counter >= 1) & (counter <= SYNC_OVERFLOW)
