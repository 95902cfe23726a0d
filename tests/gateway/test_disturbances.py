"""Whatever is written, commanded, stored and lost: no wrong sum is valid, and the skin becomes whole again."""

import struct
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc import indices as od
from dbc.canopen import NmtCommand
from dbc.configuration import configuration
from tests.layouts import small_contract
from tests.world import DISTURBANCES, RANDOM, World, drive

STEPS = 200

SMALL = small_contract()
CONTRACTS = {1: SMALL, 2: small_contract(sync={"rate_hz": 40.0, "turns": 2})}
PLACES = sorted(
    {
        (each.index, each.subindex, len(each.data))
        for node in SMALL.nodes
        for each in configuration(SMALL, node)
        if each.data_type != od.VISIBLE_STRING
    }
)
VALUES = sorted({each.data for node in SMALL.nodes for each in configuration(SMALL, node) if len(each.data) <= 4})

node = st.tuples(st.integers(0, 1), st.integers(1, 2))
place = st.one_of(
    st.sampled_from(PLACES),
    st.sampled_from(
        [(od.GAIN, 3, 4), (od.OFFSET, 7, 2), (od.HEARTBEAT_MS, 0, 2), (0x1006, 0, 4), (0x1016, 1, 4), (0x1029, 1, 1)]
    ),
    st.tuples(st.integers(0x1000, 0x2200), st.integers(0, 8), st.integers(1, 4)),
)
value = st.one_of(st.sampled_from(VALUES), st.binary(min_size=1, max_size=4))
gain = st.sampled_from([0.0, 0.5, 1.0, 2.0]).map(lambda each: struct.pack("<f", each))
action = st.one_of(
    st.just(("quiet",)),
    st.tuples(st.just("write"), node, place, value),
    st.tuples(st.just("write in segments"), node, place, value),
    st.tuples(st.just("request"), node, st.integers(0, 255), place, value),
    st.tuples(st.just("swap"), node, st.integers(0, 3)),
    st.tuples(st.just("pattern"), node, st.integers(0, 3)),
    st.tuples(st.just("write"), node, st.tuples(st.just(od.GAIN), st.integers(1, 8), st.just(4)), gain),
    st.tuples(st.just("hang"), node, st.integers(1, 5) | st.integers(1, 300)),
    st.tuples(st.just("nmt"), st.integers(0, 1), st.sampled_from(list(NmtCommand)), st.integers(0, 2)),
    st.tuples(st.just("store"), node),
    st.tuples(st.just("restore"), node),
    st.tuples(st.just("sync"), st.integers(0, 1), st.integers(0, 255)),
    st.tuples(st.just("lose"), st.integers(0, 1), st.sampled_from([0.0, 0.05, 0.5, 1.0]), st.integers(0, 2**16)),
)


@pytest.mark.slow
@pytest.mark.parametrize("gateway_loses", [False, True])
@pytest.mark.parametrize("turns", CONTRACTS)
def test_random_disturbances(gateway_loses: bool, turns: int) -> None:
    @settings(RANDOM, max_examples=max(1, DISTURBANCES // STEPS))
    @given(st.lists(action, min_size=STEPS, max_size=STEPS))
    def run(actions: list[tuple]) -> None:
        with TemporaryDirectory() as folder:
            drive(World(CONTRACTS[turns], Path(folder)), actions, gateway_loses=gateway_loses)

    run()


@pytest.mark.parametrize("turns", CONTRACTS)
def test_a_short_while_of_disturbances(tmp_path: Path, turns: int) -> None:
    """The same in little, for the quick loop: one fixed draw."""
    actions = [
        ("pattern", (0, 1), 2),
        ("store", (0, 1)),
        ("nmt", 0, NmtCommand.RESET_NODE, 0),
        ("swap", (1, 2), 1),
        ("lose", 0, 0.5, 3),
        ("sync", 1, 7),
        ("write", (1, 1), (od.GAIN, 3, 4), bytes(4)),
        ("hang", (0, 2), 3),
        *[("quiet",)] * 8,
        ("nmt", 1, NmtCommand.STOP, 0),
        *[("quiet",)] * 10,
    ]
    for gateway_loses in (False, True):
        folder = tmp_path / str(gateway_loses)
        folder.mkdir()
        drive(World(CONTRACTS[turns], folder), actions, gateway_loses=gateway_loses)
