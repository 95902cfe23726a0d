"""Commissioning over an arbitrated bus with exact bit times: each board is a station, and answers in its own time."""

import pytest

from dbc.canopen import NO_NODE_ID
from nodes.lss import LssSlave
from tests.bus.harness import frame
from tests.commissioning.fresh_boards import Bench, check_commissioning, complete, skin
from tests.layouts import buses


@pytest.mark.heavy
def test_boards_are_commissioned_one_by_one() -> None:
    assert check_commissioning(4) < 30


def test_a_run_that_was_stopped_goes_on() -> None:
    bench = Bench(skin(3))
    for node_id in (1, 2, 3):
        bench.add(node_id)
    run = bench.commission(stop_after=lambda run: "until its power" in run.boards[2].done)
    assert complete(run) == {1}
    assert run.boards[2].text == (
        "stopped in the middle: run skin commission again (so far: has node-ID 2 until its power is cut)"
    )
    assert run.boards[3].text == "not looked for: the run ended before"
    again = bench.commission()
    assert complete(again) == {1, 2, 3}
    assert again.is_whole
    assert not any(bench.is_configured(place) for place in range(3))
    for place in bench.places:
        place.boards.power_up(bench.now_s)
    assert [board.boards.nodes[0].state for board in bench.places] == [127, 127, 127]


def test_a_response_of_lss_that_is_too_short_is_no_answer() -> None:
    bench = Bench(skin(1))
    bench.add(1)
    bench.noise = frame(0x7E4, b"\x5e")
    assert complete(bench.commission()) == {1}


def test_the_configuration_is_written_and_stored() -> None:
    bench = Bench(skin(2, sync={"rate_hz": 20}))
    first = bench.add(1, contract=skin(2, sync={"rate_hz": 10}))
    run = bench.commission()
    assert complete(run) == {1}
    assert "complete, was written: 1006h:0 (Communication cycle period) was 186A0h, not C350h" in run.boards[1].text
    first.boards.power_up(bench.now_s)
    assert first.boards.nodes[0].local.unsigned(0x1006) == 50_000


def test_what_has_a_node_id_and_is_not_the_board_of_the_layout_is_named() -> None:
    contract = skin(4)
    bench = Bench(contract)
    bench.add(1, numbered=True)
    bench.add(2, contract=skin(4, device={"vendor_id": 0x55}), numbered=True)
    bench.add(3, contract=skin(4, device={"first_serial": 2}), numbered=True)
    bench.add(4, numbered=True)
    bench.add(4, contract=skin(4, device={"first_serial": 9}), numbered=True)
    run = bench.commission()
    assert complete(run) == {1}
    assert "has vendor-ID 55h, product code 534B494Eh: not a board of this skin" in run.boards[2].text
    assert (
        run.boards[3].text == "has serial number 4, that of bus0, node 4 (block 3): --renumber gives it the right one"
    )
    assert "two boards answer: they have node-ID 4" in run.boards[4].text


def test_a_board_that_answers_a_fastscan_in_spite_of_its_node_id_is_no_stranger(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scan = LssSlave._scan

    def of_lely(slave: LssSlave, *asked: int) -> bytes | None:
        wanted, slave.wanted = slave.wanted, NO_NODE_ID
        answer = scan(slave, *asked)
        slave.wanted = wanted
        return answer

    monkeypatch.setattr(LssSlave, "_scan", of_lely)
    bench = Bench(skin(2))
    for node_id in (1, 2):
        bench.add(node_id, numbered=True)
    assert bench.commission().is_whole
    assert not any(bench.is_configured(place) for place in range(2))


def test_a_board_of_another_place_loses_its_node_id() -> None:
    bench = Bench(skin(2))
    wrong = bench.add(1, contract=skin(2, device={"first_serial": 2}), numbered=True)
    bench.add(1)
    run = bench.commission(renumber=True)
    assert complete(run) == {1, 2}
    assert run.is_whole
    assert wrong.boards.nodes[0].contract.node_id == 2


def test_boards_at_another_bit_rate_get_that_of_the_layout() -> None:
    bench = Bench(skin(2))
    bench.add(1)
    bench.add(2, numbered=True)
    run = bench.commission(bit_rate_hz=125_000)
    assert run.boards[1].text == "has stored its node-ID, and 1000000 bit/s from its next power-up on"
    assert run.boards[2].text == "has its node-ID, serial number 2, and 1000000 bit/s from its next power-up on"
    assert not run.is_whole
    refused = Bench(skin(2, bus=buses(2, bitrate=500_000)))
    refused.add(1, contract=skin(2))
    refused.add(2, contract=skin(2), numbered=True)
    run = refused.commission(bit_rate_hz=250_000)
    assert run.boards[2].text.startswith("refuses 500000 bit/s: not supported")


def test_no_board_is_touched_while_a_gateway_runs() -> None:
    bench = Bench(skin(2))
    bench.add(1)
    bench.wire.put(0x80, b"")
    run = bench.commission()
    assert run.strangers == ["another program sends SYNC on this bus: stop the gateway, then commission again"]
    assert run.boards[1].text == "not looked for: the run ended before"
    assert bench.places[0].boards.nodes[0].state == 0


@pytest.mark.slow
def test_32_boards_take_less_than_30_s_of_bus_time() -> None:
    assert check_commissioning(32) < 30
