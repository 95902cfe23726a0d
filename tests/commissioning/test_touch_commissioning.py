"""Commissioning by touch, over an arbitrated bus: no serial number tells where a board sits."""

import re
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import LayoutError
from commissioning.board_steps import Commissioning
from commissioning.touch_commissioning import require_patches
from commissioning.touch_sensing import TouchSensing, map_of
from dbc.contract import Contract
from tests.commissioning.fresh_boards import Bench, complete, skin
from tests.layouts import small_boards
from tests.nodes.firmware.twins import needs_compiler


class Person:
    """Touches what the tool asks for, and lifts when it says so; `wrong` blocks are touched before the right ones."""

    def __init__(self, bench: Bench, wrong: dict[int, list[tuple[int, ...]]] | None = None) -> None:
        self.finger, self.wrong = bench.finger, wrong or {}
        self.heard: list[str] = []

    def __call__(self, line: str) -> None:
        self.heard.append(line)
        if asked := re.match(r"touch block (\d+)", line):
            block = int(asked[1])
            wrong = self.wrong.get(block, [])
            self.finger.blocks = wrong.pop(0) if wrong else (block,)
        elif line.endswith("lift"):
            self.finger.blocks = ()


def patches(nodes: int) -> Contract:
    """Return the contract of boards whose taxels lie together."""
    return skin(nodes, measurement={"wiring": "board"})


def with_serial(contract: Contract, block: int, serial: int) -> Contract:
    """Return the contract of a skin whose board of a block has a serial number."""
    device = contract.layout.device
    layout = contract.layout
    return Contract.from_layout(replaced(layout, device=replaced(device, first_serial=serial - block)))


def replaced(struct: Any, **keys: Any) -> Any:
    return msgspec.structs.replace(struct, **keys)


def mixed(contract: Contract, *, firmware: bool = False, first: int = 700) -> Bench:
    """Return a bench whose boards have descending serial numbers of a factory."""
    bench = Bench(contract)
    nodes = contract.on_bus(0)
    for node in nodes:
        built = with_serial(contract, node.block, first + len(nodes) - node.block)
        (bench.add_firmware if firmware else bench.add)(node.node_id, contract=built)
    return bench


def check_places(bench: Bench, run: Commissioning) -> None:
    """Every board has the node-ID of its place, and keeps it."""
    assert run.is_whole, [board.text for board in run.boards.values()] + run.strangers
    for node, place in zip(bench.contract.on_bus(0), bench.places, strict=True):
        booted = place.boards.power_up(bench.now_s)
        assert booted["can_id"].tolist() == [0x700 + node.node_id]


def test_a_touch_tells_where_a_board_sits() -> None:
    bench = mixed(patches(3))
    person = Person(bench)
    run = bench.touch(person)
    check_places(bench, run)
    assert [board.serial for board in run.boards.values()] == [703, 702, 701]
    assert "touch block 2, # on the map: x 8 mm, y 8 mm, z 0 mm" in person.heard
    # Nothing is left to do.
    assert bench.touch(person).is_whole


def test_a_finger_as_wide_as_a_board_touches_the_board_below_its_middle() -> None:
    """The sums of the board alone tell little of such a touch, those of its neighbours much."""
    bench = mixed(patches(4))
    bench.finger.width_m = 1.5 * bench.contract.layout.taxels.surface.pitch_m
    check_places(bench, bench.touch(Person(bench), patience_s=3.0))


def test_boards_whose_taxels_are_scattered_are_refused() -> None:
    with pytest.raises(LayoutError, match="do not lie together"):
        require_patches(skin(2))
    require_patches(patches(2))


def test_wrong_touches_are_named() -> None:
    bench = mixed(patches(3))
    person = Person(bench, {0: [(0, 1)], 2: [(1,), (0,)]})
    check_places(bench, bench.touch(person))
    said = "\n".join(person.heard)
    assert "2 boards are touched at once: lift" in said
    assert "this is block 1, whose board has its node-ID already: lift" in said
    assert "this is block 0, whose board has its node-ID already: lift" in said


def test_a_run_that_is_stopped_keeps_what_was_touched() -> None:
    bench = mixed(patches(3))
    person = Person(bench)
    run = bench.touch(person, stop_after=lambda run: bool(run.boards[2].done))
    assert not run.is_whole
    assert [board.done for board in run.boards.values()] == ["has stored its node-ID", "has stored its node-ID", ""]
    bench.finger.blocks = ()
    person.heard.clear()
    check_places(bench, bench.touch(person))
    assert sum(line.startswith("touch block") for line in person.heard) == 1


def test_a_run_that_was_killed_is_taken_up() -> None:
    bench = mixed(patches(3))
    person = Person(bench)

    def kill(run: Commissioning) -> bool:
        if run.boards[2].done:
            raise InterruptedError
        return False

    with pytest.raises(InterruptedError):
        bench.touch(person, stop_after=kill)
    bench.finger.blocks = ()
    person.heard.clear()
    # The boards that were touched have other node-IDs than those that they have stored.
    check_places(bench, bench.touch(person))
    assert [line for line in person.heard if line.startswith("touch block")] == [
        "touch block 2, # on the map: x 8 mm, y 8 mm, z 0 mm"
    ]


def test_a_hand_that_was_there_from_the_begin_gives_no_node_id() -> None:
    bench = mixed(patches(2))
    bench.finger.blocks = (1,)

    def hear(line: str) -> None:
        if line.startswith("touch"):
            bench.finger.blocks = ()

    run = bench.touch(hear, patience_s=3.0)
    assert "a touch does not end: was the skin touched at the begin?" in run.boards[1].text
    assert not complete(run)
    assert [place.node.state for place in bench.places] == [0, 0]


def test_places_without_touch_and_boards_without_place_are_named() -> None:
    bench = mixed(patches(3))
    dead = bench.places.pop(1)
    assert dead.is_alive
    stranger = bench.add(1, contract=skin(3, device={"vendor_id": 0x77}))
    person = Person(bench)
    run = bench.touch(person, patience_s=3.0)
    assert complete(run) == {1, 3}
    assert "no touch came in 3 s" in run.boards[2].text
    assert run.strangers == [
        "the board with serial number 1 (vendor-ID 77h, product code 534B494Eh): not a board of this skin"
    ]
    assert stranger.node.state == 0


@pytest.mark.heavy
def test_a_board_that_dies_and_two_with_one_serial_number_are_named() -> None:
    bench = mixed(patches(4))
    twin = bench.add(4, contract=with_serial(bench.contract, 3, 701))
    assert twin.is_alive

    def hear(line: str) -> None:
        person(line)
        if line.startswith("touch block 1"):
            bench.places[1].is_alive = False

    person = Person(bench)
    run = bench.touch(hear, patience_s=3.0)
    assert complete(run) == {1, 3}
    assert "no touch came" in run.boards[2].text
    # The two boards with one serial number have no node-ID, so no board is left for the last place.
    assert "not found" in run.boards[4].text
    assert any("serial number 701" in line and "two boards answer" in line for line in run.strangers)
    assert any("serial number 703" in line and "no answer" in line for line in run.strangers)


@pytest.mark.heavy
def test_stepped_boards_are_commissioned_by_touch() -> None:
    check = mixed(Contract.from_layout(small_boards(32, 8, 8)))
    check_places(check, check.touch(Person(check)))


@pytest.mark.heavy
@needs_compiler
@pytest.mark.parametrize("in_steps", [False, True])
def test_boards_in_c_are_commissioned_by_touch(in_steps: bool) -> None:
    contract = Contract.from_layout(small_boards(32, 8, 8)) if in_steps else patches(2)
    bench = mixed(contract, firmware=True)
    check_places(bench, bench.touch(Person(bench)))


@given(st.integers(1, 6), st.integers(0, 5), st.floats(-1.0, 1.0), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_one_touched_board_is_found_in_noise(boards: int, touched: int, zero: float, seed: int) -> None:
    random = np.random.default_rng(seed)
    rest = random.normal(1000 * zero, 3.0, (10, boards, 8))
    sensing = TouchSensing([dict(enumerate(each)) for each in rest], 4095, 0)
    now = random.normal(1000 * zero, 3.0, (boards, 8))
    assert sensing.touched(dict(enumerate(now))) == ()
    now[touched % boards] += random.choice((-1.0, 1.0), 8) * 200
    assert sensing.touched(dict(enumerate(now))) == (touched % boards,)


def test_a_map_shows_the_taxels_of_a_block() -> None:
    places = np.array([(x, y, 0.0) for y in range(2) for x in range(3)])
    assert map_of(places, np.array([1, 4, 5])) == [".#.", ".##"]
    assert map_of(places[:3], np.array([2])) == ["..#"]
