"""Stepped boards of every size, from the sensors to the image, on simulated buses."""

from typing import Any

import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st

from bandwidth.quality import heard
from canskin.errors import LayoutError
from dbc.contract import Contract
from gateway.batch import batch_of
from gateway.block_states import judge, new_states
from gateway.stepped_state import new_sums, slots_of, take_all
from nodes.steps.simulated import touched_frames
from reconstructor.stepped import SteppedImager
from shell.compiled import hold
from skin.layout import Layout
from skin.measured_sums import SteppedSums
from skin.psnr import psnr_db
from skin.sources import Frame
from skin.taxel import NOISE_N
from skin.walsh import grouped_rows
from tests.layouts import buses, small_boards, small_layout

SECONDS = 0.8


class Slide:
    """A bump that slides over the skin, and then rests."""

    has_noise = False

    def __init__(self, layout: Layout) -> None:
        taxels = layout.taxels
        self._places, self._size = np.indices((taxels.rows, taxels.columns)), min(taxels.rows, taxels.columns)
        self._is_there = np.ones(taxels.count, np.bool_)
        self._is_there[taxels.gaps] = False

    def frame(self, step: int) -> Frame:
        at = self._size * (0.3 + 0.01 * min(step, 30))
        bump = 0.01 * np.exp(-np.square(self._places - at).sum(axis=0) / self._size)
        return Frame((bump * self._is_there.reshape(bump.shape)).astype(np.float32), "bump")


def received(contract: Contract, source: Slide) -> tuple[SteppedSums, int]:
    """Return what a gateway holds after `SECONDS`, and how many frames came."""
    sums, frames = new_sums(contract), 0
    known = hold((np.ones(contract.phi.blocks, np.bool_), slots_of(contract), contract.parts, sums))
    for bus in range(len(contract.layout.bus)):
        sent = touched_frames(contract, bus, source, SECONDS, seed=1)
        take_all(batch_of(heard(contract.layout, sent, SECONDS), bus, contract.parts), known)
        frames += len(sent)
    assert sums.counts.tolist() == [frames, *[0] * 6], "every frame is used"
    shown = new_states(contract, 0)
    counts_per_unit = contract.unit_n / contract.layout.taxels.newton_per_count
    judge(round(SECONDS * 1e9), counts_per_unit, known, shown)
    return SteppedSums(shown.sums.ravel(), shown.valid > 0, shown.known.ravel() > 0, NOISE_N), frames


@pytest.mark.heavy
@pytest.mark.parametrize("is_fd", [False, True])
@pytest.mark.parametrize("taxels", [8, 16, 32, 64])
def test_images_are_closer_to_the_forces_than_the_sensors(taxels: int, is_fd: bool) -> None:
    layout = small_boards(taxels, 10, 10, fd=is_fd)
    source, imager = Slide(layout), SteppedImager(layout)
    sums, _ = received(Contract.from_layout(layout), source)
    assert sums.valid.all()
    true_n = source.frame(40).force_n
    for _ in range(20):
        image, _ = imager.solve(sums)
    sensor_n = np.maximum(0, true_n + np.random.default_rng(1).normal(0, NOISE_N, true_n.shape))
    force_max_n = layout.taxels.force_max_n
    assert psnr_db(true_n, image, force_max_n) > psnr_db(true_n, sensor_n, force_max_n) + 10


@st.composite
def layouts(draw: st.DrawFn) -> dict[str, Any]:
    """Return the tables of a skin of stepped boards: any size, shape and buses."""
    rows, columns = draw(st.integers(2, 12)), draw(st.integers(4, 12))
    taxels = draw(st.sampled_from([8, 16, 32, 64]))
    gaps = draw(st.sets(st.tuples(st.integers(0, rows - 1), st.integers(0, columns - 1)), max_size=rows * columns // 4))
    shape = ["".join("." if (row, column) in gaps else "#" for column in range(columns)) for row in range(rows)]
    measurement: dict[str, Any] = {"block_size": taxels, "wiring": "board"}
    there = [row * columns + column for row in range(rows) for column in range(columns) if (row, column) not in gaps]
    blocks = -(-len(there) // taxels)
    if draw(st.booleans()):  # boards that exist, of unequal numbers of taxels
        ends = {taxels * block for block in range(blocks)} | draw(st.sets(st.integers(1, len(there) - 1), max_size=3))
        chains = np.split(np.array(draw(st.permutations(there))), sorted(ends - {0}))
        measurement |= {"wiring": "file", "chains": [each.tolist() for each in chains]}
        blocks = len(chains)
    first = draw(st.integers(1, blocks))
    lines = [first, blocks - first] if first < blocks else [first]
    tables = {"sending": "steps", "measurement": measurement}
    return tables | {"taxels": {"shape": shape}, "bus": buses(*lines, fd=draw(st.booleans()))}


@pytest.mark.heavy
@given(layouts())
@settings(deadline=None, max_examples=15)
def test_every_layout_that_is_accepted_runs(tables: dict[str, Any]) -> None:
    shape = tables["taxels"]["shape"]
    try:
        layout = small_layout(len(shape), len(shape[0]), **tables)
    except LayoutError as error:
        told = str(error)
    else:
        told = ""
    if told:
        event("refused")
        assert "`$." in told  # where
        return
    event(f"runs: {layout.measurement.wiring}")
    contract, source = Contract.from_layout(layout), Slide(layout)
    sums, frames = received(contract, source)
    phi, unit_n = contract.phi, layout.taxels.newton_per_count
    x, y = np.random.default_rng(1).normal(size=phi.shape[1]), np.random.default_rng(2).normal(size=phi.shape[0])
    assert phi.forward(x) @ y == pytest.approx(x @ phi.adjoint(y))
    wired = phi.wired
    assert np.allclose(wired.forward(wired.adjoint(np.eye(phi.shape[0]))), phi.block_size * np.eye(phi.shape[0]))
    assert frames > 0
    true_n = phi.forward(source.frame(40).force_n.ravel().astype(np.float64)).reshape(phi.blocks, -1)
    held_n = sums.counts.reshape(phi.blocks, -1) * unit_n
    # Of the noise of 1 mN a fifth is left; what is less than the threshold is not sent.
    assert np.sqrt(np.mean(np.square(held_n - true_n))) < 0.35e-3 * phi.block_size**0.5 + 0.5e-3
    assert held_n[:, grouped_rows(phi.block_size)[0, 0]].min() >= 0
