"""LSS of virtual nodes, against the master of the canopen library and the tables of CiA 305."""

from pathlib import Path

import canopen
import pytest
from canopen.lss import LssError, LssMaster
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.contract import Contract
from dbc.dictionary import REVISION
from nodes.lss import LssSlave
from tests.bus.harness import frame
from tests.nodes.helpers import RESET_COMMUNICATION, RESET_NODE, START, ArrayLink, give, new_segment, read, sync

ADDRESS = (0x1234, 0x534B494E, 0x10001, 77)
REQUEST, RESPONSE = 0x7E5, 0x7E4


def slave(*, has_node_id: bool = False, address: tuple[int, ...] = ADDRESS) -> LssSlave:
    return LssSlave(address, [5], 500_000, lambda _: None, stored=5 if has_node_id else 255)


def address_of(contract: Contract, node_id: int) -> tuple[int, ...]:
    """Return vendor-ID, product code, revision and serial number of a node of bus0."""
    device = contract.layout.device
    return device.vendor_id, device.product_code, REVISION, device.first_serial + node_id - 1


def request(command: int, number: int) -> bytes:
    return bytes((command,)) + number.to_bytes(4, "little") + bytes(3)


class Wire(canopen.Network):
    """A network whose only participant is an LSS slave."""

    def __init__(self, *slaves: LssSlave) -> None:
        super().__init__()
        self.slaves = slaves
        self.lss.RESPONSE_TIMEOUT = 0.0001

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        assert can_id == REQUEST
        for each in self.slaves:
            answer = each.take(bytes(data))
            if answer is not None:
                self.lss.on_message_received(RESPONSE, answer, 0.0)


@pytest.fixture
def master(monkeypatch: pytest.MonkeyPatch) -> LssMaster:
    monkeypatch.setattr("canopen.lss.time.sleep", lambda _: None)
    return Wire(slave()).lss


def test_the_fastscan_of_another_master_finds_a_node(master: LssMaster) -> None:
    assert master.fast_scan() == (True, list(ADDRESS))
    assert master.network.slaves[0].is_configured
    assert master.fast_scan() == (False, None)


def test_another_master_gives_the_node_id(master: LssMaster) -> None:
    own = master.network.slaves[0]
    with pytest.raises(LssError):
        master.inquire_node_id()
    master.fast_scan()
    assert master.inquire_node_id() == 255
    assert [master.inquire_lss_address(each) for each in range(0x5A, 0x5E)] == list(ADDRESS)
    for wrong in (0, 4, 128, 200):
        with pytest.raises(LssError, match="1"):
            master.configure_node_id(wrong)
    master.configure_node_id(5)
    master.configure_bit_timing(2)
    with pytest.raises(LssError, match="1"):
        master.configure_bit_timing(0)
    master.store_configuration()
    assert own.node_id == 255
    assert not own.is_due
    master.send_switch_state_global(master.WAITING_STATE)
    assert own.is_due
    own.reset()
    assert own.node_id == 5
    master.send_switch_state_global(master.CONFIGURATION_STATE)
    master.configure_node_id(255)
    master.store_configuration()
    own.reset()
    assert own.node_id == 255


def test_a_memory_that_fails_is_told() -> None:
    def fail(_: int) -> None:
        raise OSError

    broken = LssSlave(ADDRESS, [5], 500_000, fail, stored=5)
    broken.take(bytes((4, 1, 0, 0, 0, 0, 0, 0)))
    assert broken.take(bytes((0x17, 0, 0, 0, 0, 0, 0, 0))) == bytes((0x17, 2, 0, 0, 0, 0, 0, 0))


@pytest.mark.parametrize("place", range(4))
def test_a_node_is_selected_by_its_whole_address_alone(place: int) -> None:
    numbered = slave(has_node_id=True)
    wrong = [*ADDRESS]
    wrong[place] += 1
    for numbers, is_mine in ((wrong, False), (ADDRESS, True)):
        answers = [numbered.take(request(0x40 + at, each)) for at, each in enumerate(numbers)]
        assert answers == [None, None, None, bytes((0x44, 0, 0, 0, 0, 0, 0, 0)) if is_mine else None]
        assert numbered.is_configured is is_mine


def test_only_nodes_without_node_id_answer_to_searches() -> None:
    for has_node_id in (False, True):
        each = slave(has_node_id=has_node_id)
        assert (each.take(bytes((0x51, 0, 0, 0, 0, 0x80, 0, 0))) is None) is has_node_id
        assert (each.take(bytes((0x4C, 0, 0, 0, 0, 0, 0, 0))) is None) is has_node_id


@given(st.lists(st.binary(max_size=9)), st.booleans())
def test_any_bytes_are_answered_in_eight_bytes_or_not(requests: list[bytes], has_node_id: bool) -> None:
    each = slave(has_node_id=has_node_id)
    for data in requests:
        answer = each.take(data)
        assert answer is None or (len(data) == len(answer) == 8)
    assert each.node_id in (5, 255)


@given(st.sets(st.tuples(*[st.integers(0, 2**32 - 1)] * 4), min_size=1, max_size=4))
@settings(max_examples=10, deadline=None)
def test_a_fastscan_finds_the_lowest_of_several_nodes(addresses: set[tuple[int, ...]]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("canopen.lss.time.sleep", lambda _: None)
        master = Wire(*(slave(address=each) for each in addresses)).lss
        found = [tuple(master.fast_scan()[1]) for _ in addresses]
        assert found == sorted(addresses)


def test_a_node_boots_with_the_node_id_that_it_was_given(contract: Contract, link: ArrayLink, tmp_path: Path) -> None:
    for times in range(2):
        segment = new_segment(contract, link, {1, 2}, store=tmp_path, unnumbered=True)
        # The second time, node 2 has what was stored.
        assert link.take_sent()["can_id"].tolist() == [0x702] * times
        nothing = give(segment, link, frame(0, bytes((START, 0))), frame(0, bytes((RESET_NODE, 1))), sync(1))
        assert {can_id & 127 for can_id, _ in nothing} == ({2} if times else set())
        address = address_of(contract, 2)
        give(segment, link, frame(REQUEST, request(4, 0)))
        select = [frame(REQUEST, request(0x40 + at, each)) for at, each in enumerate(address)]
        assert give(segment, link, *select) == [(RESPONSE, bytes((0x44, 0, 0, 0, 0, 0, 0, 0)))]
        given = [frame(REQUEST, bytes((command, 2, 0, 0, 0, 0, 0, 0))) for command in (0x11, 0x17)]
        assert [data[:2] for _, data in give(segment, link, *given)] == [b"\x11\0", b"\x17\0"]
        booted = give(segment, link, frame(REQUEST, bytes(8)), frame(REQUEST, bytes((4, 0, 0, 0, 0, 0, 0, 0))))
        assert booted == [(0x702, b"\0")] * (1 - times)
    assert read(segment, link, 2, 0x1018, 4) == address[3]


def test_a_board_answers_with_the_node_id_of_a_site_whose_board_has_none(contract: Contract, link: ArrayLink) -> None:
    segment = new_segment(contract, link, {1, 2}, unnumbered=True)
    address = address_of(contract, 1)
    give(segment, link, *(frame(REQUEST, request(0x40 + at, each)) for at, each in enumerate(address)))
    give(segment, link, frame(REQUEST, request(0x11, 2)), frame(REQUEST, request(4, 0)))
    assert read(segment, link, 2, 0x1018, 4) == address[3]


def test_a_node_id_that_was_not_stored_ends_with_a_reset(contract: Contract, link: ArrayLink) -> None:
    segment = new_segment(contract, link, {2}, unnumbered=True)
    scan = [(0x80, 0, 0)] + [(0, place, (place + 1) % 4) for place in range(4)]
    numbers = (0, *address_of(contract, 2))
    for number, at in zip(numbers, scan, strict=True):
        give(segment, link, frame(REQUEST, request(0x51, number)[:5] + bytes(at)))
    give(segment, link, frame(REQUEST, request(0x11, 2)), frame(REQUEST, request(4, 0)))
    assert give(segment, link, frame(0, bytes((RESET_COMMUNICATION, 2)))) == [(0x702, b"\0")]
    assert give(segment, link, frame(0, bytes((RESET_NODE, 2))), frame(0, bytes((START, 0))), sync(1)) == []
