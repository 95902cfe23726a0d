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
    # A gateway starts all nodes with one frame only when all of them are proven.
    assert list(proofs.changes(seen((0x000, bytes([START, 0]))))) == [Change(0, 1, True), Change(0, 2, True)]


def test_a_node_that_boots_is_not_proven_until_it_runs() -> None:
    proofs = InferredProofs([1, 2])
    told = seen((0x702, bytes([BOOT_UP])), (0x702, bytes([OPERATIONAL])), (0x709, bytes([BOOT_UP])))
    assert list(proofs.changes(told)) == [Change(0, 2, False), Change(1, 2, True)]


@pytest.mark.parametrize("told", [(0x000, b""), (0x000, bytes([STOP, 2, 0])), (0x702, b""), (0x702, bytes(2))])
def test_a_message_of_another_length_tells_nothing(told: tuple[int, bytes]) -> None:
    assert not list(InferredProofs([1, 2]).changes(seen(told)))


def test_a_heartbeat_tells_of_a_node_that_was_doubted_alone() -> None:
    proofs = InferredProofs([1, 2])
    assert not list(proofs.changes(seen((0x701, bytes([OPERATIONAL])), (0x000, bytes([START, 1])))))
    list(proofs.changes(seen((0x000, bytes([STOP, 1])))))
    told = seen(*((0x701, bytes([state])) for state in (4, 127, BOOT_UP)), (0x701, bytes([0x80 | OPERATIONAL])))
    assert list(proofs.changes(told)) == [Change(3, 1, True)]
    assert not list(proofs.changes(told[3:]))


def test_other_commands_and_nodes_change_nothing() -> None:
    proofs = InferredProofs([1, 2])
    told = seen(
        *((0x000, bytes([command, 1])) for command in (0x81, 0x82, 0x03)),
        (0x000, bytes([STOP, 9])),
        (0x709, bytes([BOOT_UP])),
        (0x000, bytes([START, 9])),
        (0x681, bytes([BOOT_UP])),
        (0x781, bytes([BOOT_UP])),
    )
    assert not list(proofs.changes(told))


@pytest.mark.parametrize("flags", [0x01, 0x02, 0x04])
def test_extended_remote_and_error_frames_tell_nothing(flags: int) -> None:
    told = seen((0x000, bytes([STOP, 1])), (0x701, bytes([BOOT_UP])))
    told["flags"] = flags
    proofs = InferredProofs([1])
    assert not list(proofs.changes(told))
    told["flags"] = 0x40  # the gateway's own
    assert list(proofs.changes(told)) == [Change(0, 1, False)]


def test_the_highest_node_is_followed() -> None:
    proofs = InferredProofs([127])
    assert list(proofs.changes(seen((0x77F, bytes([BOOT_UP]))))) == [Change(0, 127, False)]
