"""The same skin over SocketCAN, on vcan and through slcan adapters of the kernel; see `tests/gateway/links.py`."""

from contextlib import ExitStack

import pytest

from bus.link import Link, open_link
from tests.gateway.links import SEEDS, Ends, check_same
from tests.layouts import TURNS
from tests.vcan.slcan import Adapter


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("turns", TURNS)
@pytest.mark.parametrize("near", ["vcan", "slcan"])
def test_the_same_blocks_are_valid(near: str, turns: int, seed: int | None) -> None:
    with ExitStack() as stack:

        def link(channel: str) -> Link:
            new = open_link("socketcan", channel, 1_000_000)
            stack.callback(new.close)
            return new

        links: list[Ends] = []
        for bus in range(2):
            if near == "slcan":
                adapter = Adapter(f"slcan{bus}", f"vcan{bus}")
                adapter.plug("txqueuelen", "10", "up", "type", "can", "bitrate", "1000000")
                stack.callback(adapter.unplug)
            links.append((link(f"{near}{bus}"), link(f"vcan{bus}")))
        check_same(links, turns, seed)
