"""Whatever is written, commanded, stored and lost: no wrong sum is valid, and the skin becomes whole again."""

import os
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from dbc.canopen import NmtCommand
from dbc.configuration import configuration
from dbc.dictionary import SILENT_AFTER_S
from dbc.frame import ECHO
from dbc.indices import OD_GAIN, OD_HEARTBEAT_MS, OD_OFFSET, OD_RESTORE, OD_STORE, SIGNATURE_LOAD, SIGNATURE_SAVE
from gateway.nmt_master import LATER_S, PAUSES_S
from tests.gateway.test_proof import little, swap_mapping
from tests.gateway.world import STEP_S, EndOfWire, Wire, World, small_contract
from tests.identity import IDENTITIES

#: Disturbances in each of the four cases: the same ones in every run, or as many random ones as wanted.
DISTURBANCES = int(os.environ.get("SKIN_DISTURBANCES", "2600"))
RANDOM = settings(
    derandomize="SKIN_DISTURBANCES" not in os.environ,
    deadline=None,
    suppress_health_check=list(HealthCheck),
    phases=(Phase.explicit, Phase.generate),  # to shrink an example takes longer than all tests
)
STEPS = 200
#: After the last disturbance and the pause of a node that is out: a heartbeat, another pause, a proof that runs out.
BOUND_S = 1.0 + max(PAUSES_S) + 5.0

SMALL = small_contract()
CONTRACTS = {identity: small_contract(identity=identity) for identity in IDENTITIES}
PLACES = sorted(
    {
        (each.index, each.subindex, len(each.data))
        for node in SMALL.nodes
        for each in configuration(SMALL, node)
        if not each.is_text
    }
)
VALUES = sorted({each.data for node in SMALL.nodes for each in configuration(SMALL, node) if len(each.data) <= 4})

node = st.tuples(st.integers(0, 1), st.integers(1, 2))
place = st.one_of(
    st.sampled_from(PLACES),
    st.sampled_from(
        [(OD_GAIN, 3, 4), (OD_OFFSET, 7, 2), (OD_HEARTBEAT_MS, 0, 2), (0x1006, 0, 4), (0x1016, 1, 4), (0x1029, 1, 1)]
    ),
    st.tuples(st.integers(0x1000, 0x2200), st.integers(0, 8), st.integers(1, 4)),
)
value = st.one_of(st.sampled_from(VALUES), st.binary(min_size=1, max_size=4))
action = st.one_of(
    st.just(("quiet",)),
    st.tuples(st.just("write"), node, place, value),
    st.tuples(st.just("write in segments"), node, place, value),
    st.tuples(st.just("request"), node, st.integers(0, 255), place, value),
    st.tuples(st.just("swap"), node, st.integers(0, 3)),
    st.tuples(st.just("pattern"), node, st.integers(0, 3)),
    st.tuples(st.just("nmt"), st.integers(0, 1), st.sampled_from(list(NmtCommand)), st.integers(0, 2)),
    st.tuples(st.just("store"), node),
    st.tuples(st.just("restore"), node),
    st.tuples(st.just("sync"), st.integers(0, 1), st.integers(0, 255)),
    st.tuples(st.just("lose"), st.integers(0, 1), st.sampled_from([0.0, 0.05, 0.5, 1.0]), st.integers(0, 2**16)),
)


class Losing:
    """Loses frames at random at one end of a wire; own frames always come back."""

    def __init__(self, end: EndOfWire, ratio: float, seed: int) -> None:
        self._end, self._ratio, self._random = end, ratio, np.random.default_rng(seed)

    def __call__(self, end: EndOfWire, each: np.void) -> bool:
        return end is self._end and not each["flags"] & ECHO and self._random.random() < self._ratio


def disturb(world: World, what: tuple, *, gateway_loses: bool) -> list[int]:
    """Do one thing to the skin; return the blocks it may have changed."""
    match what:
        case ("write" | "write in segments" as how, (bus, node_id), (index, subindex, size), data):
            write = world.write if how == "write" else world.write_in_segments
            write(bus, node_id, index, subindex, data.ljust(size, b"\0")[:size])
        case ("request", (bus, node_id), command, (index, subindex, _), data):
            world.request(bus, node_id, command, index, subindex, data)
        case ("swap", (bus, node_id), tpdo):
            swap_mapping(world, bus, node_id, tpdo % len(world.contract.nodes[0].tpdos))
        case ("pattern", (bus, node_id), pattern):
            world.write(bus, node_id, 0x2021, 0, bytes((pattern,)))
        case ("nmt", bus, command, node_id):
            world.nmt(bus, command, node_id)
            return [bus * 2, bus * 2 + 1]
        case ("store", (bus, node_id)):
            world.write(bus, node_id, OD_STORE, 1, little(SIGNATURE_SAVE))
        case ("restore", (bus, node_id)):
            world.write(bus, node_id, OD_RESTORE, 1, little(SIGNATURE_LOAD))
        case ("sync", bus, counter):
            world.wires[bus].put(0x80, bytes((counter,)))
            return [bus * 2, bus * 2 + 1]
        case ("lose", bus, ratio, seed):
            wire: Wire = world.wires[bus]
            wire.loses = Losing(wire.gateway if gateway_loses else wire.nodes, ratio, seed)
            return []
        case _:
            return []
    return [bus * 2 + node_id - 1]


def drive(world: World, actions: list[tuple], *, gateway_loses: bool, pause_s: float = STEP_S) -> None:
    """Disturb a skin again and again, `pause_s` apart; then let it become whole."""
    world.until_whole(2.0)
    changed_s = np.full(world.contract.phi.blocks, -np.inf)
    limit_s = max(master.proof_limit_s for master in world.gateway.masters.values())
    for what in actions:
        for block in disturb(world, what, gateway_loses=gateway_loses):
            changed_s[block] = world.now_s
        for each in world.run(pause_s):
            for block in world.wrong_blocks(each):
                ago_s = world.now_s - changed_s[block]
                assert gateway_loses, f"block {block} is wrong"
                assert ago_s < limit_s, f"block {block} is wrong, changed {ago_s:.2f} s ago"
    for wire in world.wires:
        wire.loses = None
    world.run(SILENT_AFTER_S)  # the next heartbeat shows a command that the gateway has lost
    skip_pauses(world)
    world.until_whole(BOUND_S)


def skip_pauses(world: World) -> None:
    """Check that no node is left out for longer than the longest pause; go on as if that pause were over."""
    for master in world.gateway.masters.values():
        for each in master.nodes.values():
            if not each.in_use:
                assert each.prove_at_s <= world.now_s + LATER_S
                each.prove_at_s, each.tries = min(each.prove_at_s, world.now_s), 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gateway_loses", "identity"),
    [(False, "window"), (False, "alternating"), (True, "window"), (True, "alternating")],
)
def test_random_disturbances(gateway_loses: bool, identity: str) -> None:
    @settings(RANDOM, max_examples=max(1, DISTURBANCES // STEPS))
    @given(st.lists(action, min_size=STEPS, max_size=STEPS))
    def run(actions: list[tuple]) -> None:
        with TemporaryDirectory() as folder:
            drive(World(CONTRACTS[identity], Path(folder)), actions, gateway_loses=gateway_loses)

    run()


@pytest.mark.parametrize("identity", IDENTITIES)
def test_a_short_while_of_disturbances(tmp_path: Path, identity: str) -> None:
    """The same in little, for the quick loop: one fixed draw."""
    actions = [
        ("pattern", (0, 1), 2),
        ("store", (0, 1)),
        ("nmt", 0, NmtCommand.RESET_NODE, 0),
        ("swap", (1, 2), 1),
        ("lose", 0, 0.5, 3),
        ("sync", 1, 7),
        ("nmt", 1, NmtCommand.STOP, 0),
        *[("quiet",)] * 10,
    ]
    for gateway_loses in (False, True):
        folder = tmp_path / str(gateway_loses)
        folder.mkdir()
        drive(World(CONTRACTS[identity], folder), actions, gateway_loses=gateway_loses)
