"""The process of a bus and its clients, on real sockets and in real time."""

import os
import resource
import select
import signal
import socket
import stat
import subprocess
import sys
import time
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from bus.error_frames import ErrorClass, State
from bus.faults import Fault
from bus.link import DISCARDED, Link, open_link
from bus.protocol import HEADER, MAGIC, MAX_FRAMES, Kind, pack, runtime_folder, socket_path
from bus.server import BusServer, BusSettings
from canskin.errors import BusError, InputError, Stopped
from dbc.frame import ECHO, ERROR
from dbc.frame_bits import INTERMISSION_BITS, frame_time_ns
from shell.service import StopSignal
from tests.bus.harness import await_state, burst, collect, frame, linked, serving
from tests.processes import PATIENCE_S


def test_a_burst_arrives_in_order_and_in_its_exact_time() -> None:
    sent = burst(range(0x1C0, 0x180, -1))
    lasts_ns = int(frame_time_ns(sent, 1_000_000).sum())
    with serving("bus0"), linked("sender", "receiver") as (sender, receiver):
        before_ns = time.monotonic_ns()
        assert sender.send(sent) == 64
        arrived, echoed = collect(receiver, 64), collect(sender, 64)
        after_ns = time.monotonic_ns()
    assert list(arrived["can_id"]) == list(range(0x181, 0x1C1))
    first_ns = int(frame_time_ns(arrived[:1], 1_000_000)[0])
    assert arrived["time_ns"][-1] - arrived["time_ns"][0] == lasts_ns - first_ns
    assert before_ns + lasts_ns - INTERMISSION_BITS * 1000 <= arrived["time_ns"][-1] <= after_ns
    assert (echoed["flags"] == ECHO).all()
    echoed["flags"] = 0
    assert echoed.tobytes() == arrived.tobytes()


def test_ports_are_controllers_of_one_connection() -> None:
    sent = np.concatenate([frame(0x180 + port, port=port) for port in (3, 1, 2)])
    with serving("bus0"), linked("nodes", "gateway") as (nodes, gateway):
        nodes.send(sent)
        echoes, arrived = collect(nodes, 3), collect(gateway, 3)
    assert list(echoes["port"]) == [1, 2, 3]
    assert list(arrived["port"]) == [0, 0, 0]


def test_the_transmit_queue_is_bounded_and_credit_comes_back() -> None:
    with serving("bus0", queue_size=8), linked("a", "b") as (a, b):
        assert a.send(burst(range(20))) == 8
        collect(a, 8)
        assert a.send(burst(range(20, 26))) == 6
        assert len(collect(b, 14)) == 14


def test_a_client_that_does_not_read_loses_frames_and_nobody_else_does(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bus.session.BACKLOG_FRAMES", 200)
    sent = 0
    with serving("bus0"), linked("sender", "reader", "sleeper") as (sender, reader, sleeper):
        seen = 0
        while sent < 12_000:
            accepted = sender.send(burst(range(0x100, 0x180)))
            sent += accepted
            seen += len(collect(reader, accepted))
            collect(sender, accepted)
        got, until_s = 0, time.monotonic() + PATIENCE_S
        while got + sleeper.dropped < sent:  # the packets sent last carry the whole count
            assert time.monotonic() < until_s, f"{got} of {sent} came, {sleeper.dropped} were dropped"
            select.select([sleeper], [], [], 0.1)
            got += len(sleeper.receive())
        assert seen == sent
        assert sleeper.dropped > 0
        assert got + sleeper.dropped == sent
        assert (reader.dropped, sender.dropped) == (0, 0)


def test_alone_on_the_bus_the_sender_hears_of_missing_acknowledgements() -> None:
    with serving("bus0"), linked("alone") as (alone,):
        alone.send(frame(0x700, b"\x00"))
        await_state(alone, State.PASSIVE)
        with linked("listener") as (listener,):
            assert collect(listener, 1)["can_id"][0] == 0x700
            seen = collect(alone, 1)
            while not (seen["flags"] & ECHO).any():
                seen = collect(alone, 1)
    assert seen["can_id"][seen["flags"] == ECHO].tolist() == [0x700]


def test_bus_off_is_reported_and_heals() -> None:
    disturbed = Fault(controller="bad:0", can_id=0x181, mask=0x7FF, bit_error_rate=1.0)
    with serving("bus0", restart_s=0.05, faults=[disturbed]), linked("bad", "good") as (bad, good):
        bad.send(frame(0x181))
        seen = [collect(bad, 1)]
        while not (seen[-1]["can_id"] & ErrorClass.BUS_OFF != 0).any():
            seen.append(collect(bad, 1))
        await_state(bad, State.ACTIVE)
        assert bad.send(frame(0x182)) == 1
        assert collect(good, 1)["can_id"][-1] == 0x182
    reports = np.concatenate(seen)
    given_up = reports["flags"] == DISCARDED
    assert reports["can_id"][given_up].tolist() == [0x181]
    assert (reports["flags"][~given_up] == ERROR).all()


def test_a_frame_that_waited_too_long_comes_back_unsent() -> None:
    late = burst([0x300, 0x301])
    with serving("bus0"), linked("a", "b") as (a, b):
        late["expires_ns"] = time.monotonic_ns() + 300_000
        assert a.send(np.concatenate([burst(range(0x100, 0x110)), late])) == 18
        mine, theirs = collect(a, 18), collect(b, 16)
    assert mine["can_id"][mine["flags"] == DISCARDED].tolist() == [0x300, 0x301]
    assert theirs["can_id"].tolist() == list(range(0x100, 0x110))
    assert not mine["expires_ns"].any()


def test_each_bus_has_faults_of_its_own() -> None:
    with (
        serving("bus0", "bus1", faults=[Fault(loss_ratio=0.5)]) as server,
        linked("a", "b") as (a, b),
        linked("c", "d", channel="bus1") as (c, d),
    ):
        arrived = []
        for sender, receiver, bus in zip((a, c), (b, d), server.buses.values(), strict=True):
            sender.send(burst(range(100)))
            collect(sender, 100)
            arrived.append(collect(receiver, 100 - bus.counts.lost)["can_id"].tolist())
        assert arrived[0] != arrived[1]


@pytest.mark.parametrize(
    "garbage",
    [
        b"",
        b"GET / HTTP/1.1\r\n\r\n",
        pack(Kind.FRAMES, b"short", count=1),
        pack(Kind.FRAMES, burst([1]).tobytes(), count=2),
        pack(Kind.FRAMES, frame(0x800).tobytes(), count=1),
        pack(Kind.FRAMES, frame(1, flags=ECHO).tobytes(), count=1),
        pack(Kind.FRAMES, burst(range(300)).tobytes(), count=300),
        pack(Kind.FRAMES, frame(1, time_ns=2**63 - 1).tobytes(), count=1),
        pack(Kind.HELLO, b'{"name":"\xff"}'),
        pack(Kind.HELLO, b'{"name":"bad","bitrate":"fast"}'),
        pack(Kind.WELCOME),
        HEADER.pack(MAGIC, 99, 99, 9999, 2**63, -1),
        bytes(HEADER.size + 80 * MAX_FRAMES),
    ],
)
def test_garbage_disconnects_its_sender_alone(garbage: bytes) -> None:
    with serving("bus0"), linked("good", "other") as (good, other):
        for greet in (False, True):
            with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as bad:
                bad.settimeout(PATIENCE_S)
                bad.connect(str(socket_path("bus0")))
                if greet:
                    bad.send(pack(Kind.HELLO, b'{"name":"bad"}'))
                    assert bad.recv(1000)[4] == Kind.WELCOME
                if garbage:
                    bad.send(garbage)
                    while bad.recv(100_000)[4:5] not in (b"", bytes([Kind.REFUSED])):
                        pass  # frames may come before the end
        good.send(frame(0x123))
        assert collect(other, 1)["can_id"][0] == 0x123


def test_a_client_that_breaks_the_protocol_is_named_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with serving("bus0"), socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as bad:
        bad.settimeout(PATIENCE_S)
        bad.connect(str(socket_path("bus0")))
        for packet in (pack(Kind.HELLO, b'{"name":"bad"}'), pack(Kind.WELCOME)):
            bad.send(packet)
        while bad.recv(1000):
            pass
    assert capsys.readouterr().err == "bus: bus0: client 'bad' disconnected: a packet of kind 2\n"


def test_the_number_of_clients_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bus.server.MAX_CLIENTS", 2)
    with serving("bus0"), linked("a") as (a,):
        with linked("b"), pytest.raises(BusError, match="more than 2 clients"):
            open_link("canskin", "bus0", 1_000_000)
        c = joined_when_free("c")
        a.send(frame(0x181))
        assert collect(c, 1)["can_id"].tolist() == [0x181]
        c.close()


def test_a_client_for_whom_no_descriptor_is_left_is_taken_later(capsys: pytest.CaptureFixture[str]) -> None:
    with BusServer(["bus0"], BusSettings()) as server, socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        client.settimeout(PATIENCE_S)
        client.connect(str(socket_path("bus0")))
        client.send(pack(Kind.HELLO, b'{"name":"late"}'))
        most, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        os.close(lowest := os.dup(client.fileno()))
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest, hard))
        try:
            with mock.patch.object(select, "select", wraps=select.select) as waits:
                server.turn()
                server.turn(0.0)  # waits for others meanwhile
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        assert [len(call.args[0]) for call in waits.call_args_list] == [1, 0]
        with server.beside():
            assert client.recv(1000)[4] == Kind.WELCOME
    assert capsys.readouterr().err == "bus: bus0: cannot take a client: Too many open files\n"


def joined_when_free(name: str) -> Link:
    """Join as soon as the server has seen that another client left."""
    until_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            return open_link("canskin", "bus0", 1_000_000, name=name, wait_s=PATIENCE_S)
        except BusError:
            assert time.monotonic() < until_s


def test_another_data_rate_is_refused_where_can_fd_is_used() -> None:
    with serving("bus0", data_bitrate=5_000_000):
        with linked("classic", data_bitrate=2_000_000):
            pass
        with pytest.raises(BusError, match="its data rate is 5000000 bit/s, not 2000000"):
            open_link("canskin", "bus0", 1_000_000, fd=True, data_bitrate=2_000_000)


def test_wrong_rates_and_missing_buses_are_one_line() -> None:
    with serving("bus0", data_bitrate=None):
        for options, what in (
            ({"bitrate": 500_000}, "1000000 bit/s, not 500000"),
            ({"bitrate": 1_000_000, "fd": True}, "no CAN FD"),
        ):
            with pytest.raises(BusError, match=what) as caught:
                open_link("canskin", "bus0", **options)  # type: ignore[arg-type]
            assert "\n" not in str(caught.value)
    with pytest.raises(BusError, match="start it with 'skin bus"):
        open_link("canskin", "bus0", 1_000_000)
    with pytest.raises(InputError, match="cannot name a bus"):
        open_link("canskin", "../bus0", 1_000_000)


def test_a_stale_socket_is_replaced_and_a_live_one_is_not() -> None:
    path = socket_path("bus0")
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as stale:
        stale.bind(str(path))
    with serving("bus0"):
        with pytest.raises(BusError, match="already served"):
            BusServer(["bus1", "bus0"], BusSettings())
        assert not socket_path("bus1").exists()
        with linked("a"):
            pass
    assert not path.exists()


def test_a_folder_that_others_can_write_is_refused(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    with pytest.raises(BusError, match="can be opened by other users"):
        BusServer(["bus0"], BusSettings(), shared)


def test_sockets_lie_where_the_environment_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert runtime_folder() == Path(os.environ["SKIN_BUS_DIR"])
    monkeypatch.delenv("SKIN_BUS_DIR")
    assert runtime_folder() == tmp_path / "canskin"
    with serving("bus0"):
        assert stat.S_IMODE((tmp_path / "canskin").stat().st_mode) == 0o700
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert runtime_folder().name == f"canskin-{os.getuid()}"


@pytest.mark.heavy
def test_a_killed_process_is_noticed_and_a_new_one_is_found() -> None:
    command = [sys.executable, "-m", "skin", "bus", "bus0"]
    first = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        with linked("a", "b") as (a, b):
            a.send(frame(0x181))
            collect(b, 1)
            a.send(burst(range(200)))  # the new process knows nothing of them
            first.kill()
            first.wait()
            await_state(a, State.LOST)
            await_state(b, State.LOST)
            assert a.send(frame(0x181)) == 0
            assert len(b.receive()) == 0
            second = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
            try:
                await_state(a, State.ACTIVE)
                await_state(b, State.ACTIVE)
                assert a.send(burst(range(0x100, 0x200))) == 256
                assert collect(b, 256)["can_id"][-1] == 0x1FF
            finally:
                second.send_signal(signal.SIGTERM)
                said = second.communicate(timeout=PATIENCE_S)[1]
            assert second.returncode == 0
            scheduling, ready = said.splitlines()
            assert scheduling.startswith("bus: scheduling: ")
            assert ready == "bus: ready: bus0 at 1000000 bit/s"
    finally:
        first.kill()
        first.communicate()


def test_a_link_may_be_closed_twice() -> None:
    with serving("bus0"), linked("a") as (a,):
        a.close()
        assert (a.send(frame(1)), len(a.receive())) == (0, 0)


def test_a_stop_is_heeded_while_a_bus_is_awaited() -> None:
    stop = StopSignal()
    stop.set()
    with pytest.raises(Stopped):
        open_link("canskin", "nowhere", 1_000_000, wait_s=PATIENCE_S, stop=stop)
