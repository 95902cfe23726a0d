"""Real stepped nodes beside the gateway: whatever others write and command, no valid block shows other sums."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.messages import Measurement
from dbc import indices as od
from dbc.canopen import COB_ID_INVALID, COB_ID_NO_RTR, NmtCommand
from dbc.configuration import configuration
from nodes.steps.boards import SteppedBoards
from tests.gateway.boards import small_stepped, sums_of
from tests.nodes.stepped_bus import Press
from tests.world import DISTURBANCES, RANDOM, World, drive, valid

ACTIONS = 100
#: Time between two disturbances.
PAUSE_S = 0.05

STEPPED = small_stepped()
#: What is compared, and orders and settings that change no sum; identifiers stay those of the node.
PLACES = sorted(
    {
        (each.index, each.subindex, len(each.data))
        for each in configuration(STEPPED, STEPPED.nodes[0])
        if each.data_type != od.VISIBLE_STRING and each.index // 0x200 != od.TPDO_COMMUNICATION // 0x200
    }
)
node = st.tuples(st.integers(0, 1), st.integers(1, 2))
place = st.one_of(
    st.sampled_from(PLACES),
    st.sampled_from([(od.REFRESH, 0, 1), (od.SENDING, 1, 4)]),
    st.tuples(st.integers(0x1001, 0x1020), st.integers(0, 8), st.integers(1, 4)),
)
action = st.one_of(
    st.just(("quiet",)),
    st.tuples(st.just("write"), node, place, st.binary(min_size=1, max_size=4)),
    st.tuples(st.just("write in segments"), node, place, st.binary(min_size=1, max_size=4)),
    st.tuples(st.just("request"), node, st.integers(0, 255), place, st.binary(min_size=1, max_size=4)),
    st.tuples(st.just("pattern"), node, st.integers(0, 3)),
    st.tuples(st.just("identifier"), node, st.booleans()),
    st.tuples(st.just("nmt"), st.integers(0, 1), st.sampled_from(list(NmtCommand)), st.integers(0, 2)),
    st.tuples(st.just("store"), node),
    st.tuples(st.just("restore"), node),
    st.tuples(st.just("sync"), st.integers(0, 1), st.integers(0, 255)),
    st.tuples(st.just("lose"), st.integers(0, 1), st.sampled_from([0.0, 0.05, 0.5, 1.0]), st.integers(0, 2**16)),
)


class SteppedWorld(World):
    """A skin of stepped nodes that feel an even touch; `touched` holds its sums, in the order of Φ."""

    step_s = 1e-3

    touched: npt.NDArray[np.int32] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.until_whole(2.0)
        self.run(1.0)
        self.touched = np.stack([sums_of(self.measured[-1], node.block) for node in self.contract.nodes])
        #: What is not worth a frame, and what the filter still follows after a pattern; patterns change far more.
        units = 8 * self.contract.unit_n / self.contract.layout.taxels.newton_per_count
        self._tolerance = units + 0.01 * np.abs(self.touched)

    def new_hardware(self) -> SteppedBoards:
        blocks = [node.block for node in self.contract.nodes]
        return SteppedBoards(self.contract, blocks, Press(self.contract), noise_n=0.0)

    def _wrong_blocks(self, measurement: Measurement) -> list[int]:
        """Return the valid blocks whose sums are off by more than eight units and a hundredth, once known."""
        if self.touched is None:
            return []
        shown = np.stack([sums_of(measurement, block) for block in range(len(self.touched))])
        is_off = (np.abs(shown - self.touched) > self._tolerance).any(axis=1)
        return np.flatnonzero(is_off & valid(measurement)).tolist()


def with_identifiers(actions: list[tuple]) -> list[tuple]:
    """Replace each `identifier` by a write that switches the TPDO of a node off, or on again."""
    written = []
    for each in actions:
        if each[0] == "identifier":
            _, (bus, node_id), is_on = each
            (mine,) = next(node for node in STEPPED.on_bus(bus) if node.node_id == node_id).tpdos
            value = mine.cob_id | COB_ID_NO_RTR | (0 if is_on else COB_ID_INVALID)
            where = (od.TPDO_COMMUNICATION, 1, 4)
            written.append(("write", (bus, node_id), where, value.to_bytes(4, "little")))
        else:
            written.append(each)
    return written


@pytest.mark.slow
def test_random_disturbances() -> None:
    @settings(RANDOM, max_examples=max(1, DISTURBANCES // 2 // ACTIONS))
    @given(st.lists(action, min_size=ACTIONS, max_size=ACTIONS))
    def run(actions: list[tuple]) -> None:
        with TemporaryDirectory() as folder:
            world = SteppedWorld(STEPPED, Path(folder))
            drive(world, with_identifiers(actions), gateway_loses=False, pause_s=PAUSE_S)

    run()


def test_a_short_while_of_disturbances(tmp_path: Path) -> None:
    """The same in little, for the quick loop: one fixed draw."""
    actions = [
        ("pattern", (0, 1), 2),
        ("store", (0, 1)),
        ("nmt", 0, NmtCommand.RESET_NODE, 0),
        ("identifier", (1, 2), False),
        ("lose", 0, 0.5, 3),
        ("nmt", 1, NmtCommand.STOP, 0),
        *[("quiet",)] * 10,
    ]
    world = SteppedWorld(STEPPED, tmp_path)
    drive(world, with_identifiers(actions), gateway_loses=False, pause_s=PAUSE_S)
