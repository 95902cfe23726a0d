"""Requests about the calibration that meet others, and what is told after a write."""

from collections.abc import Callable

import msgspec
import numpy as np
import pytest

import gateway.calibration
from canskin.calibration_messages import CalibrationReply, CalibrationRequest
from canskin.errors import InputError
from dbc.contract import Contract
from gateway.calibration import GatewayCalibration, node_values
from skin.calibration_file import encoded, new_calibration, parse_calibration
from tests.gateway.boards import small_adaptive
from tests.layouts import small_contract


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
    content = encoded(new_calibration(small.layout, gains=np.full(128, 1.1)))
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
    asked, empty = Asked(small), new_calibration(small.layout)
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


def test_a_request_may_be_as_long_as_every_number_of_the_skin_needs(small: Contract) -> None:
    """32 bytes for each of 32 sums and for two numbers of each of 128 taxels, and 64 KiB."""
    most = 32 * (32 + 2 * 128) + 65_536
    asked, content = Asked(small), encoded(new_calibration(small.layout, offsets_n=np.zeros(32)))
    asked.ask(CalibrationRequest(action="load", content=content.ljust(most)))
    asked.ask(CalibrationRequest(action="load", content=content.ljust(most + 1)))
    assert [(each.is_done, each.text) for each in asked.replies] == [
        (True, "in use"),
        (False, f"a calibration of {most + 1} bytes: expected {most} at most for this skin"),
    ]


def test_show_tells_what_is_in_use(small: Contract) -> None:
    asked = Asked(small)
    asked.ask(CalibrationRequest(action="show"))
    ((is_done, text),) = [(each.is_done, each.text) for each in asked.replies]
    assert (is_done, text) == (True, "the calibration in use")
    asked = Asked(small_adaptive())
    asked.ask(CalibrationRequest(action="show"))
    assert asked.replies[0].is_done
    assert asked.replies[0].text.startswith("adaptive boards measure their offsets at power-up")


def test_show_tells_all_that_was_stored(small: Contract) -> None:
    known = msgspec.structs.replace(
        new_calibration(small.layout, offsets_n=np.full(32, 0.0078125), gains=np.full(128, 1.25)),
        taxel_offsets_n=[0.001] * 128,
    )
    replies: list[CalibrationReply] = []
    calibration = GatewayCalibration(small, known, tares=False)
    calibration.ask(CalibrationRequest(action="show"), replies.append)  # type: ignore[arg-type]
    calibration.tick({}, 0.0)
    told = parse_calibration(replies[0].content, small.layout, "test")
    assert (told.gains, told.taxel_offsets_n, told.version) == ([1.25] * 128, [0.001] * 128, known.version)
    assert told.offsets_n == pytest.approx([0.0078125] * 32)
    assert replies[0].status is not None


def test_a_region_on_the_skin_reaches_the_calibrator(small: Contract, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, taken = Asked(small), list[dict[str, object]]()
    monkeypatch.setattr(asked.calibration._calibrator, "tare", lambda **given: taken.append(given))
    taxels = small.layout.taxels
    last = (taxels.rows - 1, taxels.columns - 1)
    asked.ask(CalibrationRequest(action="tare", region=(0, 0, *last)))
    asked.ask(CalibrationRequest(action="tare", region=(0, 0, *last)))
    assert taken == 2 * [{"force": False, "region": (0, 0, *last)}]
    assert asked.replies == []
    asked.ask(CalibrationRequest(action="tare", force=True))
    assert asked.replies.pop().text == "another tare is under way: ask again when it has ended"
    asked.ask(CalibrationRequest(action="tare", region=(0, 0, taxels.rows, 0)))
    asked.ask(CalibrationRequest(action="tare", region=(0, 0, 1, 1), force=True))
    assert [each.is_done for each in asked.replies] == [False, False]
    assert asked.replies[0].text.startswith(f"region 0,0,{taxels.rows},0: expected first row, first column")
    assert asked.replies[1].text == "a tare of a region, and by force: expected one of both"
    assert len(taken) == 2


def test_requests_are_answered_one_in_a_tick(small: Contract) -> None:
    calibration, replies = GatewayCalibration(small, tares=False), list[CalibrationReply]()
    for _ in range(2):
        calibration.ask(CalibrationRequest(action="show"), replies.append)  # type: ignore[arg-type]
    for count in (1, 2, 2):
        calibration.tick({}, 0.0)
        assert len(replies) == count


def test_answers_are_given_in_another_thread(small: Contract) -> None:
    aside: list[Callable[[], None]] = []
    replies: list[CalibrationReply] = []
    calibration = GatewayCalibration(small, tares=False, submit=aside.append)
    calibration.ask(CalibrationRequest(action="show"), replies.append)  # type: ignore[arg-type]
    content = encoded(new_calibration(small.layout, offsets_n=np.zeros(32)))
    calibration.ask(CalibrationRequest(action="load", content=content), replies.append)  # type: ignore[arg-type]
    for _ in range(2):
        calibration.tick({}, 0.0)
    assert (len(aside), replies) == (2, [])
    for each in aside:
        each()
    assert [each.text for each in replies] == ["the calibration in use", "in use"]


# What nodes are given


def test_nodes_undo_gain_and_offset_of_a_taxel() -> None:
    """A taxel reads g f + o; the node takes x / g - o / g, in counts of 1 mN here."""
    skin = small_contract()
    known = msgspec.structs.replace(
        new_calibration(skin.layout, gains=np.full(128, 0.5)), taxel_offsets_n=[0.010] * 64 + [-0.020] * 64
    )
    gains, offsets = node_values(known, 0.001)
    assert gains is not None
    assert offsets is not None
    assert set(gains.tolist()) == {2.0}
    assert offsets.tolist() == [-20.0] * 64 + [40.0] * 64
    gains, offsets = node_values(msgspec.structs.replace(known, gains=[]), 0.001)
    assert gains is None
    assert offsets is not None
    assert offsets.tolist() == [-10.0] * 64 + [20.0] * 64
    gains, offsets = node_values(msgspec.structs.replace(known, taxel_offsets_n=[]), 0.001)
    assert gains is not None
    assert (gains.tolist(), offsets) == ([2.0] * 128, None)
    assert node_values(new_calibration(skin.layout), 0.001) == (None, None)


def test_a_node_holds_offsets_of_sixteen_bits(small: Contract) -> None:
    known = new_calibration(small.layout)
    held = msgspec.structs.replace(known, taxel_offsets_n=[-32767.0, 32768.0] * 64)
    _, offsets = node_values(held, 1.0)
    assert offsets is not None
    assert offsets.tolist()[:2] == [32767.0, -32768.0]
    for beyond_n, counts in ((-32768.0, "32768"), (32769.0, "-32769")):
        values = [0.0] * 128
        values[5] = values[9] = beyond_n
        values[100] = 70_000.0
        with pytest.raises(InputError) as refused:
            node_values(msgspec.structs.replace(known, taxel_offsets_n=values), 1.0)
        assert str(refused.value) == (
            "taxel_offsets_n / gains of 3 taxels, first of taxel 5: nodes would add"
            f" {counts} counts, and can hold -32768 to 32767"
        )
