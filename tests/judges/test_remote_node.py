"""A CANopen master that is not ours: the nodes as the ``canopen`` library's RemoteNode sees them, with their EDS."""

import threading
from collections.abc import Callable, Iterator
from operator import attrgetter
from typing import Generic, TypeVar

import canopen
import pytest

from dbc.generate import DEFAULT_FOLDER
from dbc.indices import is_program_download
from skin.layout import load_layout
from tests.processes import PATIENCE_S, Processes

pytestmark = pytest.mark.heavy

NODES = 3
SUMS, TEST_PATTERN, GAIN, FINGERPRINT = 0x2100, 0x2021, 0x2010, 0x2002
RAMP = 2
BOOT_UP, PRE_OPERATIONAL = 0, 127
ERROR_FIELD, SYNC_COUNTER = 0x1003, 0x2022
SYNC_LENGTH, HEARTBEAT_LOST, NO_ERROR = 0x8240, 0x8130, 0x0000


Arrival = TypeVar("Arrival")


class Arrivals(Generic[Arrival]):
    """What a node sends, in order; the library's own waits miss what comes before they begin."""

    def __init__(self, subscribe: Callable[[Callable[[Arrival], object]], None], key: Callable[[Arrival], int]) -> None:
        self._news = threading.Condition()
        self._arrived: list[Arrival] = []
        self._key = key
        subscribe(self._take)

    def expect(self, wanted: int, doing: Callable[[], object] = lambda: None) -> Arrival:
        """Do something, then wait for what has the key `wanted`, and return it."""
        with self._news:
            self._arrived.clear()
        doing()
        with self._news:
            assert self._news.wait_for(lambda: wanted in map(self._key, self._arrived), PATIENCE_S), (
                f"no {wanted} in {list(map(self._key, self._arrived))}"
            )
            return next(each for each in self._arrived if self._key(each) == wanted)

    def _take(self, arrival: Arrival) -> None:
        with self._news:
            self._arrived.append(arrival)
            self._news.notify()


def heartbeats(node: canopen.RemoteNode) -> Arrivals[int]:
    return Arrivals(node.nmt.add_heartbeat_callback, int)


@pytest.fixture(scope="module")
def network(processes: Processes) -> Iterator[canopen.Network]:
    """Join a bus with three nodes."""
    processes.skin("bus", "bus", "bus0")
    processes.await_words("bus", "ready")
    master = canopen.Network()
    master.NOTIFIER_SHUTDOWN_TIMEOUT = PATIENCE_S
    master.connect(interface="canskin", channel="bus0")
    eds = str(DEFAULT_FOLDER / "skin.eds")
    for node_id in range(1, NODES + 1):
        node = master.add_node(canopen.RemoteNode(node_id, canopen.import_od(eds, node_id)))
        node.sdo.RESPONSE_TIMEOUT = PATIENCE_S
    heartbeats(master[NODES]).expect(
        BOOT_UP, lambda: processes.skin("nodes", "nodes", "--only", f"bus0:1-{NODES}", "--no-fabric")
    )
    yield master
    master.disconnect()


@pytest.fixture(scope="module")
def beats(network: canopen.Network) -> dict[int, Arrivals[int]]:
    return {node_id: heartbeats(network[node_id]) for node_id in network}


@pytest.fixture(scope="module")
def emergencies(network: canopen.Network) -> Arrivals[canopen.emcy.EmcyError]:
    """Return the emergencies of node 1, by their code."""
    return Arrivals(network[1].emcy.add_callback, attrgetter("code"))


@pytest.fixture
def node(network: canopen.Network, beats: dict[int, Arrivals[int]]) -> canopen.RemoteNode:
    """Return node 1 after a reset of all."""
    for each in network.values():
        reset(each, beats)
        each.emcy.reset()
    return network[1]


def reset(node: canopen.RemoteNode, beats: dict[int, Arrivals[int]], command: int = 0x81) -> None:
    beats[node.id].expect(BOOT_UP, lambda: node.nmt.send_command(command))


def test_boot_shows_who_the_node_is(node: canopen.RemoteNode, beats: dict[int, Arrivals[int]]) -> None:
    beats[1].expect(PRE_OPERATIONAL)
    assert node.sdo["Identity"]["Product code"].raw == int.from_bytes(b"SKIN", "big")
    assert node.sdo["Identity"]["Serial number"].raw == 1
    # Longer than four bytes: segmented uploads.
    assert node.sdo[0x1008].raw == node.object_dictionary[0x1008].default
    assert node.sdo[FINGERPRINT].raw == load_layout().phi().fingerprint


def test_every_object_of_the_eds_can_be_read(node: canopen.RemoteNode) -> None:
    read = 0
    for entry in node.object_dictionary.values():
        for variable in entry.values() if hasattr(entry, "values") else (entry,):
            # No error has come (CiA 301, 7.5.2.4); nodes in Python have no program download.
            is_missing = is_program_download(variable.index)
            if is_missing or (variable.index == ERROR_FIELD and variable.subindex):
                with pytest.raises(canopen.SdoAbortedError) as raised:
                    node.sdo.upload(variable.index, variable.subindex)
                assert raised.value.code == (0x0602_0000 if is_missing else 0x0800_0024)
            elif variable.readable:
                assert len(node.sdo.upload(variable.index, variable.subindex)) >= len(variable) // 8
                read += 1
    assert read > 100


def test_the_dictionary_is_written_in_one_frame_and_in_segments(
    node: canopen.RemoteNode, beats: dict[int, Arrivals[int]]
) -> None:
    node.sdo[0x1017].raw = 40
    assert node.sdo[0x1017].raw == 40
    half = node.object_dictionary[GAIN][3].encode_raw(0.5)
    node.sdo.download(GAIN, 3, half, force_segment=True)
    assert node.sdo[GAIN][3].raw == 0.5
    reset(node, beats)
    assert node.sdo[GAIN][3].raw == 1.0


@pytest.mark.parametrize(
    ("index", "subindex", "data", "code"),
    [
        (FINGERPRINT, 0, b"0000", 0x0601_0002),  # read-only
        (0x5FFF, 0, b"0", 0x0602_0000),  # no such object
        (GAIN, 99, bytes(4), 0x0609_0011),  # no such sub-index
        (0x1800, 2, b"\xf8", 0x0609_0030),  # reserved transmission type
    ],
)
def test_wrong_writes_are_aborted_with_the_standards_codes(
    node: canopen.RemoteNode, index: int, subindex: int, data: bytes, code: int
) -> None:
    with pytest.raises(canopen.SdoAbortedError) as raised:
        node.sdo.download(index, subindex, data)
    assert raised.value.code == code


def test_sums_arrive_as_the_master_mapped_them(node: canopen.RemoteNode, network: canopen.Network) -> None:
    node.tpdo.read()
    tpdo = node.tpdo[1]
    tpdo.clear()
    tpdo.add_variable(SYNC_COUNTER)
    for subindex in (8, 1, 5):
        tpdo.add_variable(SUMS, subindex, 14)
    tpdo.add_variable(0x1001)
    tpdo.trans_type, tpdo.sync_start_value, tpdo.enabled = 1, 0, True
    tpdo.save()
    node.sdo[TEST_PATTERN].raw = RAMP
    node.nmt.state = "OPERATIONAL"
    Arrivals(tpdo.add_callback, attrgetter("cob_id")).expect(tpdo.cob_id, lambda: network.sync.transmit(7))
    assert len(tpdo.data) == 8
    # The library reads a variable from two bytes, and a sum of 14 bits may lie in three.
    packed = int.from_bytes(tpdo.data, "little")
    carried = [packed >> begin & 0x3FFF for begin in (8, 22, 36)]
    assert carried == [node.sdo[SUMS][subindex].raw & 0x3FFF for subindex in (8, 1, 5)]
    assert any(carried)
    assert (tpdo.data[0], packed >> 50) == (7, 0)


def test_a_sync_of_the_wrong_length_is_an_emergency_until_it_is_right(
    node: canopen.RemoteNode, network: canopen.Network, emergencies: Arrivals[canopen.emcy.EmcyError]
) -> None:
    node.nmt.state = "OPERATIONAL"
    wrong = emergencies.expect(SYNC_LENGTH, network.sync.transmit)  # 1019h wants a counter
    assert wrong.register & 0x11 == 0x11
    assert node.sdo[0x1003][1].raw & 0xFFFF == SYNC_LENGTH
    assert node.sdo[0x1001].raw & 0x10
    assert emergencies.expect(NO_ERROR, lambda: network.sync.transmit(1)).register == 0


@pytest.mark.heavy
def test_a_node_reports_the_heartbeat_it_misses(
    node: canopen.RemoteNode,
    network: canopen.Network,
    beats: dict[int, Arrivals[int]],
    emergencies: Arrivals[canopen.emcy.EmcyError],
) -> None:
    node.sdo[0x1016][1].raw = 2 << 16 | 200
    node.nmt.state = "OPERATIONAL"
    beats[2].expect(PRE_OPERATIONAL, lambda: network[2].sdo.download(0x1017, 0, bytes((20, 0))))
    lost = emergencies.expect(HEARTBEAT_LOST, lambda: network[2].sdo.download(0x1017, 0, bytes(2)))
    assert lost.data[0] == 2
    beats[1].expect(PRE_OPERATIONAL, lambda: node.sdo.download(0x1017, 0, bytes((20, 0))))  # as 1029h says
    assert emergencies.expect(NO_ERROR, lambda: network[2].sdo.download(0x1017, 0, bytes((20, 0)))).register == 0


def test_reset_communication_keeps_what_the_node_measures(
    node: canopen.RemoteNode, beats: dict[int, Arrivals[int]]
) -> None:
    node.sdo[GAIN][1].raw = 0.25
    node.sdo[0x1017].raw = 30
    reset(node, beats, 0x82)
    assert node.sdo[0x1017].raw == 1000
    assert node.sdo[GAIN][1].raw == 0.25


def test_stored_parameters_outlive_a_reset(node: canopen.RemoteNode, beats: dict[int, Arrivals[int]]) -> None:
    node.sdo[0x1017].raw = 123
    node.sdo.download(0x1010, 1, b"save")
    node.sdo[0x1017].raw = 456
    reset(node, beats)
    assert node.sdo[0x1017].raw == 123
    node.sdo.download(0x1011, 1, b"load")
    reset(node, beats)
    assert node.sdo[0x1017].raw == 1000
