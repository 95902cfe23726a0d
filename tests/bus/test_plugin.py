"""python-can and canopen on the virtual bus."""

import asyncio
import select
import time

import can
import canopen
import pytest

from bus.faults import Fault
from bus.plugin import ArbitratedBus
from dbc.frame import FD
from tests.bus.harness import collect, frame, linked, serving
from tests.processes import PATIENCE_S


def open_bus(**options: object) -> can.BusABC:
    return can.Bus(interface="canskin", channel="bus0", ignore_config=True, wait_s=PATIENCE_S, **options)


def test_python_can_finds_the_interface_by_its_name() -> None:
    with serving("bus0"), open_bus() as bus:
        assert isinstance(bus, ArbitratedBus)
        assert [one["channel"] for one in can.detect_available_configs("canskin")] == ["bus0"]


@pytest.mark.parametrize(
    "options",
    [
        {"arbitration_id": 0x123, "data": b"\x01\x02", "is_extended_id": False},
        {"arbitration_id": 0x1ABCDEF0, "data": bytes(8), "is_extended_id": True},
        {"arbitration_id": 0x700, "is_remote_frame": True, "dlc": 1, "is_extended_id": False},
        {"arbitration_id": 0x181, "data": bytes(range(64)), "is_fd": True, "bitrate_switch": True},
        {"arbitration_id": 0x181, "data": bytes(12), "is_fd": True, "error_state_indicator": True},
        {"arbitration_id": 0x181, "timestamp": 1e10, "is_extended_id": False},  # is sent at once all the same
    ],
)
def test_messages_arrive_as_they_were_sent(options: dict[str, object]) -> None:
    sent = can.Message(check=True, **options)
    with serving("bus0"), open_bus(fd=True) as one, open_bus(fd=True) as two:
        one.send(sent)
        got = two.recv(PATIENCE_S)
        assert got is not None
        assert got.equals(sent, timestamp_delta=None, check_channel=False, check_direction=False)
        assert got.is_rx
        assert abs(got.timestamp - time.time()) < PATIENCE_S
        assert one.recv(0.0) is None


def test_nothing_is_told_to_wait_when_all_messages_are_read() -> None:
    """An event loop would turn for ever; messages come in one packet and are read one by one."""
    with serving("bus0"), open_bus() as one, open_bus() as two:
        for can_id in range(1, 21):
            one.send(can.Message(arbitration_id=can_id, is_extended_id=False))
        got = [two.recv(PATIENCE_S) for _ in range(20)]
        assert [each.arbitration_id for each in got if each] == list(range(1, 21))
        assert select.select([two], [], [], 0) == ([], [], [])


def test_own_messages_and_filters() -> None:
    with (
        serving("bus0"),
        open_bus(receive_own_messages=True, can_filters=[{"can_id": 0x180, "can_mask": 0x780}]) as one,
        open_bus() as two,
    ):
        for can_id in (0x100, 0x181):
            two.send(can.Message(arbitration_id=can_id, is_extended_id=False))
        got = [one.recv(PATIENCE_S)]
        one.send(can.Message(arbitration_id=0x182, is_extended_id=False))
        got.append(one.recv(PATIENCE_S))
        assert [(one.arbitration_id, one.is_rx) for one in got if one] == [(0x181, True), (0x182, False)]


def test_a_full_queue_raises_and_a_timeout_waits_for_room() -> None:
    with serving("bus0", queue_size=4, data_bitrate=None), open_bus() as one, open_bus() as two:
        two.send(can.Message(arbitration_id=0x701, is_extended_id=False))
        message = can.Message(arbitration_id=0x181, is_extended_id=False, data=bytes(8))
        for _ in range(4):
            one.send(message)
        with pytest.raises(can.CanOperationError, match="queue full"):
            one.send(message)
        for _ in range(50):
            one.send(message, timeout=PATIENCE_S)
        got = one.recv(PATIENCE_S)  # what comes while a sender waits is kept
        assert got is not None
        assert got.arbitration_id == 0x701
        with pytest.raises(can.CanOperationError, match="CAN FD on a classical link"):
            one.send(can.Message(arbitration_id=1, is_extended_id=False, is_fd=True))


def test_error_frames_and_states() -> None:
    with (
        serving("bus0", faults=[Fault(controller="python-can:0", bit_error_rate=1.0)], restart_s=5.0),
        open_bus() as one,
        linked("other"),
    ):
        assert one.state is can.BusState.ACTIVE
        one.send(can.Message(arbitration_id=0x181, is_extended_id=False))
        until = time.monotonic() + PATIENCE_S
        while one.state is not can.BusState.ERROR and time.monotonic() < until:
            got = one.recv(PATIENCE_S)
            assert got is not None
            assert got.is_error_frame
        assert one.state is can.BusState.ERROR
        with pytest.raises(can.CanOperationError, match="bus-off"):
            one.send(can.Message(arbitration_id=0x181, is_extended_id=False))


def test_a_bus_that_is_gone_raises_and_nothing_hangs() -> None:
    with serving("bus0"):
        one = open_bus()
        with pytest.raises(can.CanInitializationError, match="it runs at 1000000 bit/s, not 500000"):
            open_bus(bitrate=500_000)
    try:
        with pytest.raises(can.CanOperationError, match="gone"):
            one.recv(PATIENCE_S)
        with pytest.raises(can.CanOperationError):
            one.send(can.Message(arbitration_id=1, is_extended_id=False))
        assert one.state is can.BusState.ERROR
    finally:
        one.shutdown()
        one.shutdown()
    with pytest.raises(can.CanOperationError, match="shut down"):
        one.recv(0.0)
    with pytest.raises(can.CanInitializationError, match="start it with 'skin bus'"):
        can.Bus(interface="canskin", channel="bus0", ignore_config=True)


def test_a_notifier_in_an_event_loop_gets_every_message() -> None:
    async def gather() -> list[int]:
        with open_bus() as one, open_bus() as two:
            reader = can.AsyncBufferedReader()
            notifier = can.Notifier(two, [reader], loop=asyncio.get_running_loop())
            for can_id in range(20):
                one.send(can.Message(arbitration_id=can_id, is_extended_id=False))
            got = [(await asyncio.wait_for(reader.get_message(), PATIENCE_S)).arbitration_id for _ in range(20)]
            notifier.stop()
            return got

    with serving("bus0"):
        assert asyncio.run(gather()) == list(range(20))


@pytest.mark.heavy
def test_an_sdo_goes_from_one_network_to_another() -> None:
    dictionary = canopen.ObjectDictionary()
    for index, kind in ((0x2000, canopen.objectdictionary.UNSIGNED32), (0x2001, canopen.objectdictionary.DOMAIN)):
        entry = canopen.objectdictionary.ODVariable(f"entry {index:x}", index)
        entry.data_type = kind
        dictionary.add_object(entry)
    master, slave = canopen.Network(), canopen.Network()
    with serving("bus0"):
        try:
            for network in (master, slave):
                network.connect(interface="canskin", channel="bus0", bitrate=1_000_000)
            slave.add_node(canopen.LocalNode(5, dictionary))
            remote = master.add_node(canopen.RemoteNode(5, dictionary))
            remote.sdo.RESPONSE_TIMEOUT = PATIENCE_S
            remote.sdo.download(0x2000, 0, (123_456).to_bytes(4, "little"))
            assert int.from_bytes(remote.sdo.upload(0x2000, 0), "little") == 123_456
            long = bytes(range(200))
            remote.sdo.download(0x2001, 0, long)
            assert remote.sdo.upload(0x2001, 0) == long
        finally:
            master.disconnect()
            slave.disconnect()


def test_a_link_and_a_python_can_bus_share_a_bus() -> None:
    with serving("bus0"), linked("link", fd=True) as (link,), open_bus(fd=True) as bus:
        link.send(frame(0x181, bytes(64), FD))
        got = bus.recv(PATIENCE_S)
        assert got is not None
        assert (got.is_fd, got.dlc) == (True, 64)
        bus.send(can.Message(arbitration_id=0x182, is_extended_id=False, data=b"\x07"))
        assert collect(link, 2)["can_id"].tolist() == [0x181, 0x182]
