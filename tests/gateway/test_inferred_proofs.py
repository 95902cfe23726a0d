"""What the frames of a log tell of the proofs of nodes."""

import numpy as np
import pytest

from dbc.frame import frames
from gateway.inferred_proofs import Change, InferredProofs

START, STOP, PRE_OPERATIONAL = 0x01, 0x02, 0x80  # CiA 301, NMT commands
BOOT_UP, OPERATIONAL = 0x00, 0x05  # CiA 301, states of a heartbeat


def seen(*told: tuple[int, bytes]) -> np.ndarray:
    made = frames(len(told))
    for one, (can_id, data) in zip(made, told, strict=True):
        one["can_id"], one["length"] = can_id, len(data)
        one["data"][: len(data)] = tuple(data)
    return made


@pytest.mark.parametrize("command", [STOP, PRE_OPERATIONAL])
def test_a_command_to_all_ends_the_proof_of_every_node_and_one_to_a_node_of_this_alone(command: int) -> None:
    proofs = InferredProofs([1, 2, 5])
    assert list(proofs.changes(seen((0x000, bytes([command, 2]))))) == [Change(0, 2, False)]
    assert list(proofs.changes(seen((0x181, b""), (0x000, bytes([command, 0]))))) == [
        Change(1, 1, False),
        Change(1, 5, False),
    ]
    assert list(proofs.changes(seen((0x000, bytes([START, 5]))))) == [Change(0, 5, True)]
    assert not list(proofs.changes(seen((0x000, bytes([START, 0])))))  # a gateway starts each node after its proof


def test_a_node_that_boots_is_not_proven_until_it_runs() -> None:
    proofs = InferredProofs([1, 2])
    told = seen((0x702, bytes([BOOT_UP])), (0x702, bytes([OPERATIONAL])), (0x709, bytes([BOOT_UP])))
    assert list(proofs.changes(told)) == [Change(0, 2, False), Change(1, 2, True)]


@pytest.mark.parametrize("told", [(0x000, b""), (0x000, bytes([STOP, 2, 0])), (0x702, b""), (0x702, bytes(2))])
def test_a_message_of_another_length_tells_nothing(told: tuple[int, bytes]) -> None:
    assert not list(InferredProofs([1, 2]).changes(seen(told)))
