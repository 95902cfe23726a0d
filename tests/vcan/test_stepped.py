"""Stepped nodes and their gateway on a real kernel: the gateway holds what touches the nodes."""

from collections.abc import Iterator

import numpy as np
import pytest

from canskin.messages import BlockState
from tests.stepped_skin import RestingSkin, resting_skin


@pytest.fixture(scope="module")
def skin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RestingSkin]:
    with resting_skin(tmp_path_factory.mktemp("steps"), "-i", "socketcan", "-c", "vcan0") as started:
        started.start("nodes")
        started.start("gateway")
        yield started


def test_the_gateway_holds_the_touch(skin: RestingSkin) -> None:
    held_n = skin.await_rest()
    assert skin.is_true(held_n)
    assert np.count_nonzero(held_n[:, 0]) >= 4  # a touch that several boards feel
    assert (skin.statuses[-1].frames.malformed, skin.statuses[-1].frames.different) == (0, 0)


def test_a_gateway_that_comes_back_knows_the_whole_skin_again(skin: RestingSkin) -> None:
    before_n = skin.await_rest()
    skin.kill("gateway")
    skin.start("gateway")
    after_n = skin.await_rest()
    assert (np.abs(after_n - before_n) <= skin.unsent_n).all()


def test_nodes_that_go_are_dead_and_whole_when_they_are_back(skin: RestingSkin) -> None:
    before_n = skin.await_rest()
    skin.kill("nodes")
    skin.await_states(BlockState.DEAD)
    newest = skin.measurements[-1]
    assert not any(newest.valid)
    assert not any(newest.known)
    skin.start("nodes")
    after_n = skin.await_rest()
    assert (np.abs(after_n - before_n) <= skin.unsent_n).all()


def test_boards_in_c_show_the_touch(skin: RestingSkin) -> None:
    skin.kill("nodes")
    skin.await_states(BlockState.DEAD)
    skin.start("nodes", "--firmware")
    assert skin.is_true(skin.await_rest())
    assert skin.statuses[-1].frames.malformed == 0
