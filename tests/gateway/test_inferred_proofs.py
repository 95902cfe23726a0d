"""What the frames of a log tell of the proofs of nodes."""

import numpy as np
import pytest

from dbc.frame import frames
from gateway.inferred_proofs import InferredProofs

#: CiA 301: NMT commands to node 2 and to all, boot-up messages and heartbeats.
START, STOP, PRE_OPERATIONAL = ((0x000, bytes((command, 2))) for command in (0x01, 0x02, 0x80))
STOP_ALL, PRE_OPERATIONAL_ALL, START_ALL = ((0x000, bytes((command, 0))) for command in (0x02, 0x80, 0x01))
BOOT, BEAT = (0x702, b"\0"), (0x702, b"\5")


def seen(*told: tuple[int, bytes], flags: int = 0) -> np.ndarray:
    made = frames(len(told))
    for one, (can_id, data) in zip(made, told, strict=True):
        one["can_id"], one["length"], one["flags"] = can_id, len(data), flags
        one["data"][: len(data)] = tuple(data)
    return made


@pytest.mark.parametrize(
    ("told", "changes"),
    [
        *(([command], ["0: 2 no"]) for command in (STOP, PRE_OPERATIONAL)),
        *(
            ([(0x181, b""), command], ["1: 1 no", "1: 2 no", "1: 127 no"])
            for command in (STOP_ALL, PRE_OPERATIONAL_ALL)
        ),
        ([STOP, STOP_ALL], ["0: 2 no", "1: 1 no", "1: 127 no"]),
        ([STOP, START], ["0: 2 no", "1: 2 yes"]),
        # A gateway starts all nodes with one frame only when all of them are proven.
        ([STOP, START_ALL], ["0: 2 no", "1: 2 yes"]),
        ([BOOT, BEAT], ["0: 2 no", "1: 2 yes"]),
        # A heartbeat in another state tells nothing; the highest bit of the state is that of node guarding.
        ([STOP, (0x702, b"\4"), (0x702, b"\x7f"), (0x702, b"\x85")], ["0: 2 no", "3: 2 yes"]),
        ([(0x77F, b"\0")], ["0: 127 no"]),
        # What was not doubted cannot be proven.
        ([BEAT, START, START_ALL], []),
        # Of another length; resets, and other commands; other nodes and identifiers.
        ([(0x000, b""), (0x000, b"\2\2\0"), (0x702, b""), (0x702, bytes(2))], []),
        ([(0x000, bytes((command, 1))) for command in (0x81, 0x82, 0x03)], []),
        ([(0x000, b"\2\x09"), (0x709, b"\0"), (0x000, b"\1\x09"), (0x681, b"\0"), (0x781, b"\0")], []),
    ],
)
def test_proofs_begin_with_starts_and_end_with_stops_and_boots(
    told: list[tuple[int, bytes]], changes: list[str]
) -> None:
    proofs = InferredProofs([1, 2, 127])
    found = [
        f"{place}: {node} {'yes' if is_proven else 'no'}" for place, node, is_proven in proofs.changes(seen(*told))
    ]
    assert found == changes


@pytest.mark.parametrize(("flags", "count"), [(0x01, 0), (0x02, 0), (0x04, 0), (0x40, 1)])
def test_extended_remote_and_error_frames_tell_nothing_and_the_gateways_own_do(flags: int, count: int) -> None:
    assert len(list(InferredProofs([2]).changes(seen(STOP, BOOT, flags=flags)))) == count
