"""The chain in one process: sums of touched nodes give the image of the touch."""

import numpy as np
import pytest

from dbc.contract import Contract
from dbc.packing import packing
from nodes.simulated import REST_S, Nodes
from reconstructor.engine import Reconstructor
from reconstructor.imaging import CycleImager
from skin.layout import changed
from skin.psnr import psnr_db
from skin.sources import Frame
from tests.layouts import small_layout

LAYOUT = small_layout(32, 32, sampling={"rate_hz": 1000.0})
REST_CYCLES = round(REST_S * LAYOUT.sync.rate_hz)


class Bump:
    """Nothing touches for `REST_S`, then a bump of 10 mN."""

    has_noise = False

    def frame(self, step: int) -> Frame:
        i, j = np.indices((32, 32))
        touch = 0.01 * np.exp(-((i - 12) ** 2 + (j - 20) ** 2) / 20)
        return Frame((touch * (step >= REST_CYCLES)).astype(np.float32), "bump" * (step >= REST_CYCLES))


class Bump16(Bump):
    """The quarter of the bump that a smaller skin has."""

    def frame(self, step: int) -> Frame:
        return Frame(super().frame(step + REST_CYCLES).force_n[8:24, 8:24], "bump")


@pytest.mark.parametrize(("taxels", "gain_db"), [(8, 9), (16, 10), (32, 10), (64, 10)])
def test_images_are_closer_to_the_forces_than_the_sensors(taxels: int, gain_db: int) -> None:
    layout = small_layout(32, 32, sampling={"rate_hz": 1000.0}, measurement={"block_size": taxels})
    nodes, imager = Nodes(layout, Bump(), seed=1), CycleImager(layout)
    for _ in range(REST_CYCLES + 20):
        measurement = nodes.measurement(nodes.sample())
        image, _ = imager.solve(imager.decode(measurement, layout.phi()))
        truth = nodes.truth()
    assert truth.label == "bump"
    assert (measurement.cycle, measurement.sync_counter) == (nodes.cycle, nodes.counter)
    assert measurement.sampled_mono_ns == nodes.time_ns == nodes.cycle * 10_000_000
    true_n, sensor_n = (np.frombuffer(each, "<f4").reshape(32, 32) for each in (truth.true, truth.sensor))
    force_max_n = layout.taxels.force_max_n
    assert psnr_db(true_n, image, force_max_n) > psnr_db(true_n, sensor_n, force_max_n) + gain_db


def test_images_in_turns_are_solved_as_such() -> None:
    turns = changed(LAYOUT, sync={"turns": 2})
    nodes, imager = Nodes(turns, Bump(), seed=1), CycleImager(turns)
    engine = Reconstructor(turns.phi(), 32, 32, samples=10, turns=2)
    for _ in range(10):
        sums = imager.decode(nodes.measurement(nodes.sample()), turns.phi())
        sums_n = np.multiply(sums.counts, turns.taxels.newton_per_count, dtype=np.float32)
        np.testing.assert_array_equal(imager.solve(sums)[0], engine.solve(sums_n, sums.valid_sums))


def test_in_turns_half_of_the_sums_are_new_in_each_cycle() -> None:
    turns = changed(LAYOUT, sync={"turns": 2})
    together, apart = Nodes(LAYOUT, Bump(), seed=1), Nodes(turns, Bump(), seed=1)
    contract = Contract.from_layout(turns)
    before = None
    for _ in range(REST_CYCLES + 6):
        new, newest = together.sample(), apart.sample()
        came = contract.table.gather[contract.table.turn == contract.turn_of(apart.counter)].ravel()
        expected = new.copy() if before is None else before
        expected[came] = new[came]
        np.testing.assert_array_equal(newest, expected)
        before = newest.copy()
    assert 0 < came.size < new.size
    assert (new != newest).any()


def test_sums_are_those_that_frames_carry() -> None:
    layout = small_layout(16, 16, encoding={"sum_bits": 8, "offset_binary": True})
    nodes, step = Nodes(layout, Bump16(), seed=1), packing(layout).scale
    exact = Nodes(small_layout(16, 16, encoding={"sum_bits": 16}), Bump16(), seed=1).sample()
    sent = np.frombuffer(nodes.measurement(nodes.sample()).sums, "<i4")
    assert step == 256
    assert not (sent % step).any()
    assert 0 < np.abs(sent - exact).max() <= step // 2


def test_the_same_seed_gives_the_same_sums() -> None:
    first, again, other = (Nodes(LAYOUT, Bump(), seed=seed) for seed in (1, 1, 2))
    sums = [np.stack([each.sample() for _ in range(3)]) for each in (first, again, other)]
    np.testing.assert_array_equal(sums[0], sums[1])
    assert (sums[0] != sums[2]).any()
