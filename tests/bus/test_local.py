"""Links of the process that serves the buses: they hear and send the same as clients on sockets."""

import time
from contextlib import ExitStack

import numpy as np
import pytest

from bus.error_frames import State
from bus.link import Link
from bus.options import BusOptions, serve_buses
from bus.server import BusServer, BusSettings
from canskin.errors import InputError
from dbc.frame import ECHO, FD, Frames, frames
from skin.layout import load_layout
from tests.bus.harness import burst, frame, linked, serving
from tests.processes import PATIENCE_S


def heard(server: BusServer, links: list[Link], count: int) -> list[Frames]:
    """Serve until each link has `count` frames."""
    arrived, until_s = [frames(0)] * len(links), time.monotonic() + PATIENCE_S
    while min(map(len, arrived)) < count:
        assert time.monotonic() < until_s
        server.ready(links, 0.01, whole=False)
        arrived = [np.concatenate((each, link.receive())) for each, link in zip(arrived, links, strict=True)]
    return arrived


def test_local_and_other_links_hear_each_other() -> None:
    with BusServer(["bus0", "bus1"], BusSettings()) as server, ExitStack() as stack:
        own = server.join("bus0", "nodes")
        with server.beside():  # a client is welcomed while the process waits for something else
            (gateway,) = stack.enter_context(linked("gateway"))
        sent = np.concatenate([frame(0x180 + port, port=port) for port in (3, 1, 2)])
        assert own.send(sent) == 3
        gateway.send(frame(0x80, b"\1"))
        mine, theirs = heard(server, [own, gateway], 4)
    assert sorted(mine["can_id"].tolist()) == sorted(theirs["can_id"].tolist()) == [0x80, 0x181, 0x182, 0x183]
    assert (mine["time_ns"] == theirs["time_ns"]).all()
    is_sums = mine["can_id"] > 0x80
    assert mine["flags"].tolist() == np.where(is_sums, ECHO, 0).tolist()
    assert theirs["flags"].tolist() == np.where(is_sums, 0, ECHO).tolist()
    assert (mine["port"] == np.where(is_sums, mine["can_id"] - 0x180, 0)).all()
    assert own.explain() == ""


def test_a_local_link_has_queues_and_limits_of_a_client(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bus.session.BACKLOG_FRAMES", 8)
    with BusServer(["bus0"], BusSettings(data_bitrate=None, queue_size=8)) as server:
        one, other = server.join("bus0", "one"), server.join("bus0", "other")
        assert one.send(burst(range(20))) == 8
        with pytest.raises(InputError, match="CAN FD on a classical link"):
            one.send(frame(1, flags=FD))
        heard(server, [one], 8)
        for can_id in range(4):  # `other` does not read
            one.send(frame(can_id))
            heard(server, [one], 1)
        kept = len(other.receive())
        assert kept <= 8
        assert other.dropped + kept == 12
        other.close()
        one.send(frame(1))
        server.ready([one], 0.02, whole=True)
        assert one.state is State.PASSIVE  # nobody acknowledges
        assert not len(other.receive())  # nor hears
        other.close()
        with pytest.raises(InputError, match="expected one of the buses bus0, got 'bus1'"):
            server.join("bus1", "one")


@pytest.mark.parametrize(
    ("options", "is_served"),
    [(BusOptions(), True), (BusOptions("socketcan"), False), (BusOptions(bus_option=["x=1"]), False)],
)
def test_buses_are_served_where_nobody_does(options: BusOptions, is_served: bool) -> None:
    layout = load_layout(None)
    server = serve_buses(layout, options)
    assert (server is not None) == is_served
    if server is not None:
        with server:
            assert list(server.buses) == ["bus0", "bus1", "bus2", "bus3"]
            assert serve_buses(layout, options) is None
    with serving("bus2"):
        assert serve_buses(layout, options) is None
