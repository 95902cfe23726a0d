"""LSS of boards in C: the same answers as from nodes in Python, and commissioned like them."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.contract import sync_frame
from dbc.dictionary import REVISION
from nodes.firmware.library import Firmware
from nodes.segment import Segment
from nodes.sending import sending_of
from nodes.storage import Storage
from nodes.virtual_boards import VirtualBoards
from tests.bus.harness import frame
from tests.commissioning.fresh_boards import Bench, check_commissioning, complete, skin
from tests.nodes.firmware.twins import Rolling, describe, needs_compiler, small_contract
from tests.nodes.helpers import ArrayLink, new_sampler

pytestmark = needs_compiler

REQUEST = 0x7E5
NUMBERS = (0, 1, 2, REVISION, 0x534B494E, 0x534B494F, 0x80000000)
COMMANDS = (0x04, 0x11, 0x13, 0x15, 0x17, *range(0x40, 0x44), *range(0x46, 0x4D), 0x51, *range(0x5A, 0x5F))
#: Vendor-ID, product code, revision and serial number of node 2.
ADDRESS = (0, 0x534B494E, REVISION, 2)
SELECT = [bytes((0x40 + place,)) + number.to_bytes(4, "little") + bytes(3) for place, number in enumerate(ADDRESS)]
IDENTIFY = [
    bytes((0x46 + place,)) + number.to_bytes(4, "little") + bytes(3)
    for place, number in enumerate((*ADDRESS[:2], 0, REVISION, 1, 2))
]
SCAN = [
    bytes((0x51,)) + number.to_bytes(4, "little") + bytes(at)
    for number, at in [(0, (128, 0, 0)), *((each, (0, place, (place + 1) % 4)) for place, each in enumerate(ADDRESS))]
]


def requests() -> st.SearchStrategy[list[tuple[int, bytes]]]:
    """Requests of LSS: whole services, single requests, and resets by NMT."""
    number = st.sampled_from(NUMBERS).map(lambda each: each.to_bytes(4, "little"))
    end = st.tuples(st.sampled_from((0, 1, 31, 128)), st.integers(0, 4), st.integers(0, 4)).map(bytes)
    single = st.builds(
        lambda *parts: b"".join(parts), st.sampled_from([bytes((each,)) for each in COMMANDS]), number, end
    )
    give = st.sampled_from(
        [[bytes((0x11, each)).ljust(8, b"\0"), bytes((0x17,)).ljust(8, b"\0")] for each in (2, 255, 3)]
    )
    services = st.one_of(
        st.sampled_from([SELECT, IDENTIFY, SCAN]),
        give,
        single.map(lambda each: [each]),
        st.binary(max_size=8).map(lambda each: [each]),
    ).map(lambda all_of: [(REQUEST, each) for each in all_of])
    reset = st.sampled_from((129, 130)).map(lambda command: [(0, bytes((command, 0)))])
    return st.lists(st.one_of(services, services, services, reset), max_size=12).map(
        lambda parts: [each for part in parts for each in part]
    )


@pytest.mark.heavy
@given(requests(), st.booleans())
@settings(max_examples=60)
def test_boards_in_c_answer_as_those_in_python(asked: list[tuple[int, bytes]], unnumbered: bool) -> None:
    contract = small_contract()
    boards = (
        VirtualBoards(contract, 0, {2}, new_sampler(contract), unnumbered=unnumbered),
        Firmware(contract, [contract.on_bus(0)[1]], unnumbered=unnumbered).boards(0),
    )
    said = []
    for each in boards:
        sent = [each.power_up(0.0), *(each.take(frame(can_id, data), 0.0) for can_id, data in asked)]
        said.append([[(int(one["can_id"]), one["data"][: one["length"]].tobytes()) for one in burst] for burst in sent])
    assert said[0] == said[1]


def test_boards_that_have_exchanged_their_node_ids_feel_the_taxels_of_their_own_places(tmp_path: Path) -> None:
    contract = small_contract()
    first, second = contract.on_bus(0)
    Storage.of_node(contract, first, tmp_path).save_node_id(2)
    Storage.of_node(contract, second, tmp_path).save_node_id(1)
    sent = []
    for firmware in (None, Firmware(contract, [first, second], store=tmp_path, unnumbered=True)):
        hardware = sending_of(contract.layout).hardware(contract, [0, 1], Rolling(contract), firmware)
        boards = firmware.boards(0) if firmware else VirtualBoards(contract, 0, {1, 2}, hardware, store=tmp_path)
        link = ArrayLink()
        segment = Segment(contract, 0, boards, hardware, link.send, complain=lambda _: None)
        segment.boot(0.0)
        for each in (frame(0, bytes((1, 0))), sync_frame(1), sync_frame(2)):
            segment.take(each, 0.0)
        sent.append(sorted(map(describe, link.take_sent())))
    assert sent[0] == sent[1]
    assert len(sent[0]) == 2 + 2 * sum(len(node.tpdos) for node in (first, second))


def test_a_board_with_another_node_id_for_a_while_has_not_what_its_own_has_stored(tmp_path: Path) -> None:
    """Stored COB-IDs are those of a node-ID: the board would send the frames of two."""
    contract = small_contract()
    node = contract.on_bus(0)[0]
    Storage.of_node(contract, node, tmp_path).save({0x1014: {0: bytes((0x81, 0, 0, 0))}, 0x1017: {0: b"\x07\0"}})
    select = [*SELECT[:3], bytes((0x43, node.node_id)).ljust(8, b"\0")]
    given = [*select, bytes((0x11, 2)).ljust(8, b"\0"), bytes((0x04,)).ljust(8, b"\0")]
    for boards in (
        VirtualBoards(contract, 0, {1}, new_sampler(contract), store=tmp_path, unnumbered=True),
        Firmware(contract, [node], store=tmp_path, unnumbered=True).boards(0),
    ):
        boards.power_up(0.0)
        for each in given:
            boards.take(frame(REQUEST, each), 0.0)
        read = [boards.take(frame(0x602, bytes((0x40, index, 0x10)).ljust(8, b"\0")), 0.0) for index in (0x14, 0x17)]
        values = [int.from_bytes(bytes(each["data"][0, 4:8]), "little") for each in read]
        assert values == [0x82, 1000], type(boards).__name__


@pytest.mark.heavy
def test_boards_in_c_are_commissioned_and_keep_their_node_ids(tmp_path: Path) -> None:
    bench = Bench(skin(2))
    places = [bench.add_firmware(node_id, store=tmp_path) for node_id in (1, 2)]
    run = bench.commission()
    assert run.is_whole
    assert complete(run) == {1, 2}
    assert [each.boards.power_up(bench.now_s)["can_id"].tolist() for each in places] == [[0x701], [0x702]]
    assert [each.name for each in sorted(tmp_path.iterdir())] == ["bus0-1.json", "bus0-2.json"]


@pytest.mark.slow
def test_boards_in_c_die_and_are_named_like_those_in_python() -> None:
    assert check_commissioning(4, Bench.add_firmware) < 30
