"""A CAN log, decoded by the gateway's loop."""

from collections.abc import Callable, Mapping

import numpy as np

from canskin.errors import InputError
from canskin.messages import FrameCounts, Measurement
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import Frames
from gateway.playback import play
from rebuild.cycles import Cycles
from skin.measured_sums import used_blocks


def replay(
    contract: Contract, logged: Mapping[int, Frames], advance: Callable[[int], None]
) -> tuple[Cycles, FrameCounts]:
    """Return the cycles of a log, and how its frames were counted.

    See `gateway.playback` for which blocks are valid.

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
    made: list[Measurement] = []
    for part in play(contract, logged):
        made += part.measurements
        advance(len(part.measurements))
    if not made:
        identity = contract.layout.sync.identity
        length = "without data" if identity == "window" else "with a counter, 1 byte"
        raise InputError(
            f'the log holds no SYNC {length} (COB-ID {SYNC_COB_ID:02X}h, sync.identity = "{identity}" of the layout): '
            "it cannot be cut into cycles"
        )
    counts = np.stack([np.frombuffer(each.sums, "<i4") for each in made])
    valid = np.stack([used_blocks(each, contract.phi) for each in made])
    return Cycles(counts, valid, np.array([each.sampled_mono_ns for each in made], np.int64)), part.status.frames
