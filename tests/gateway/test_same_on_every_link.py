"""The same skin with the same touches over each kind of link: the same blocks are valid, with the same sums.

`tests/vcan/test_same_on_every_link.py` has the links that need a CAN kernel.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from bus.link import Link, State, open_link
from tests.bus.harness import await_state, serving
from tests.bus.serial_adapter import SerialAdapter
from tests.gateway.links import CONTRACTS, SEEDS, Ends, LinkWire, LinkWorld, check_same
from tests.layouts import TURNS
from tests.processes import PATIENCE_S
from tests.world import BOUND_S, valid

#: What runs a command in a network of its own, through which multicast goes.
OWN_NETWORK = ("unshare", "--map-root-user", "--net", "sh", "-euc")
SET_UP = "ip link set lo up; ip route add 239.0.0.0/8 dev lo"
IS_INSIDE = "SKIN_OWN_NETWORK" in os.environ
KINDS = ("udp_multicast",) if IS_INSIDE else ("virtual", "slcan", "skin bus")


@contextmanager
def opened(kind: str, folder: Path) -> Iterator[list[Ends]]:
    """Open the links of two buses."""
    with ExitStack() as stack:

        def link(interface: str, channel: str, **options: float) -> Link:
            new = open_link(interface, channel, 1_000_000, wait_s=PATIENCE_S, options=options)
            stack.callback(new.close)
            return new

        def ends(bus: int) -> Ends:
            if kind == "slcan":
                adapter = SerialAdapter(folder / f"ttyACM{bus}")
                stack.callback(adapter.unplug)
                return link("slcan", str(adapter.path), sleep_after_open=0.0), adapter
            interface = "canskin" if kind == "skin bus" else kind
            channel = f"239.74.163.{bus + 2}" if kind == "udp_multicast" else f"bus{bus}"
            return link(interface, channel), link(interface, channel)

        if kind == "skin bus":
            stack.enter_context(serving("bus0", "bus1"))
        yield [ends(bus) for bus in range(2)]


@pytest.mark.heavy
@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("turns", TURNS)
@pytest.mark.parametrize("kind", KINDS)
def test_the_same_blocks_are_valid(kind: str, turns: int, seed: int | None, tmp_path: Path, own_sockets: None) -> None:
    with opened(kind, tmp_path) as links:
        check_same(links, turns, seed)


@pytest.mark.heavy
@pytest.mark.skipif(IS_INSIDE, reason="is inside")
def test_the_same_blocks_are_valid_through_multicast() -> None:
    if subprocess.run([*OWN_NETWORK, SET_UP], check=False).returncode:
        pytest.skip("NOT TESTED: udp_multicast, for which this machine makes no network of its own")
    test = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", __file__, "-k", "udp_multicast"]
    done = subprocess.run(
        [*OWN_NETWORK, f'{SET_UP}; exec "$@"', "-", *test],
        env={**os.environ, "SKIN_OWN_NETWORK": "1"},
        check=False,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.heavy
def test_a_serial_adapter_is_unplugged_and_the_skin_is_whole_again(tmp_path: Path) -> None:
    with opened("slcan", tmp_path) as links:
        world, (link, adapter) = LinkWorld(CONTRACTS[1], links=links), links[0]
        wire = world.wires[0]
        assert isinstance(wire, LinkWire)
        assert isinstance(adapter, SerialAdapter)
        for _ in range(2):
            world.until_whole(BOUND_S)
            wire.is_plugged = False
            adapter.unplug()
            await_state(link, State.LOST)
            assert valid(world.run(1.0)[-1]).tolist() == [False, False, True, True]
            adapter.plug()
            await_state(link, State.ACTIVE)
            wire.is_plugged = True
        world.until_whole(BOUND_S)
        assert not any(map(world.wrong_blocks, world.measured))
