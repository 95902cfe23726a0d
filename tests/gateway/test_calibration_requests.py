"""Requests about the calibration that meet others, and what is told after a write."""

import msgspec
import numpy as np
import pytest

import gateway.calibration
from calibration.stored import encoded, parse_calibration, store
from canskin.calibration_messages import CalibrationReply, CalibrationRequest
from dbc.contract import Contract
from gateway.calibration import GatewayCalibration


class Writing:
    """A writing to nodes that ends when the test says so."""

    done, is_complete = False, True

    def __init__(self, *_: object) -> None:
        """Write nothing."""

    def tick(self, _now_s: float) -> None:
        """Do nothing."""

    def text(self) -> str:
        return "written"


class Asked:
    """A calibration, and the answers that came."""

    def __init__(self, contract: Contract) -> None:
        self.calibration, self.now_s = GatewayCalibration(contract, tares=False), 0.0
        self.replies: list[CalibrationReply] = []

    def ask(self, request: CalibrationRequest) -> None:
        self.calibration.ask(request, self.replies.append)  # type: ignore[arg-type]
        self.calibration.tick({}, self.now_s)


@pytest.fixture
def writing(monkeypatch: pytest.MonkeyPatch) -> type[Writing]:
    class Mine(Writing):
        pass

    monkeypatch.setattr(gateway.calibration, "NodeWriting", Mine)
    return Mine


def test_nodes_are_written_to_once_at_a_time(small: Contract, writing: type[Writing]) -> None:
    asked = Asked(small)
    content = encoded(store(small.layout, gains=np.full(128, 1.1)))
    asked.ask(CalibrationRequest(action="write", content=content))
    assert asked.replies == []
    asked.ask(CalibrationRequest(action="write", content=content))
    ((is_done, text),) = [(each.is_done, each.text) for each in asked.replies]
    assert (is_done, text) == (False, "the nodes are being written to: wait for the end of that")
    writing.done = True
    asked.calibration.tick({}, 0.0)
    assert [each.is_done for each in asked.replies] == [False, True]
    asked.ask(CalibrationRequest(action="write", content=content))
    assert [each.is_done for each in asked.replies] == [False, True, True]


@pytest.mark.parametrize("is_complete", [True, False])
def test_what_the_nodes_have_is_told(small: Contract, writing: type[Writing], *, is_complete: bool) -> None:
    """A write of offsets alone leaves the gains."""
    writing.done, writing.is_complete = True, is_complete
    asked, empty = Asked(small), store(small.layout)
    for values in ({"gains": [1.25] * 128}, {"taxel_offsets_n": [0.001] * 128}):
        wanted = msgspec.structs.replace(empty, **values)
        asked.ask(CalibrationRequest(action="write", content=encoded(wanted)))
    asked.ask(CalibrationRequest(action="show"))
    assert [each.is_done for each in asked.replies] == [is_complete, is_complete, True]
    told = parse_calibration(asked.replies[-1].content, small.layout, "test")
    assert told.gains == [1.25] * 128 * is_complete
    assert told.taxel_offsets_n == [0.001] * 128 * is_complete


def test_a_zero_that_is_awaited_counts_as_a_request_that_waits(small: Contract) -> None:
    asked = Asked(small)
    for _ in range(8):
        asked.ask(CalibrationRequest(action="tare"))
    assert asked.replies == []
    asked.ask(CalibrationRequest(action="show"))
    assert [each.text for each in asked.replies] == ["8 requests wait for an answer: ask again later"]
    asked.now_s = 7.9
    asked.calibration.tick({}, asked.now_s)
    assert len(asked.replies) == 1
    asked.calibration.tick({}, 8.1)
    assert [each.is_done for each in asked.replies] == [False] * 9
