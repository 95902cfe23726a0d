"""What the schemes send and show, where the answer is known."""

from typing import Literal

import numpy as np
import pytest

from dbc.canopen import TPDO_BASES
from dbc.contract import Contract
from evaluation.schemes.events import run_events
from evaluation.schemes.judge import Images, Updates, quality
from evaluation.schemes.patches import patches
from evaluation.schemes.scan import run_scan
from evaluation.schemes.scenes import Touch
from evaluation.schemes.schemes import Events, Scan, Scheme, Sums, measure_scheme
from evaluation.schemes.smoothing import refined, smoothed
from evaluation.schemes.sums import SOLVED_NS, run_sums
from skin.layout import load_layout

NEWTON_PER_COUNT = 0.02 / 1023
SHORT = Touch("golf-ball", ticks=120)


def steps(*levels: int, ticks: int = 20) -> np.ndarray:
    """Return counts of a skin whose taxel 100 takes each level for `ticks` milliseconds; all else is 0."""
    counts = np.zeros((ticks * len(levels), 4096), np.int16)
    for place, level in enumerate(levels):
        counts[ticks * place : ticks * (place + 1), 100] = level
    return counts


@pytest.mark.parametrize("side", [64, 32, 16, 8])
def test_every_cell_has_one_node_and_all_buses_have_as_many(side: int) -> None:
    held = patches(side)
    assert np.array_equal(np.sort(held.ravel()), np.arange(side * side))
    assert held.shape[0] == 4


def test_a_change_is_sent_once_it_reaches_the_threshold_and_no_smaller_one() -> None:
    run = run_events(steps(0, 99, 100, 199, 0), NEWTON_PER_COUNT, 100 * NEWTON_PER_COUNT)
    shown = np.rint(run.updates.force_n / NEWTON_PER_COUNT).astype(int)
    assert shown.tolist() == [100, 0]
    assert set(run.updates.taxel.tolist()) == {100}
    # 2 bytes: 47 + 16 bits and some stuff bits, at once on an idle bus.
    assert np.all((run.latency_ns >= 60_000) & (run.latency_ns < 80_000))
    assert run.waiting_ns.size == 0


def test_a_dead_taxel_waits() -> None:
    run = run_events(steps(0, 500, 0, ticks=10), NEWTON_PER_COUNT, 100 * NEWTON_PER_COUNT, dead_ms=15)
    assert np.rint(run.updates.force_n / NEWTON_PER_COUNT).astype(int).tolist() == [500, 0]
    assert np.floor(run.latency_ns / 1e6).tolist() == [0, 5]


def test_a_full_bus_leaves_high_node_ids_waiting() -> None:
    random = np.random.default_rng(0)
    counts = random.integers(0, 1024, (80, 4096)).astype(np.int16)
    run = run_events(counts, NEWTON_PER_COUNT, 50 * NEWTON_PER_COUNT)
    assert run.sent.traffic()["load"] > 0.99
    node = run.sent.asked.frames["can_id"][run.frame_of].astype(int) - TPDO_BASES[0] - 1
    sent = np.bincount(node, minlength=32)
    assert sent[0] > sent[1] > 0
    assert not sent[8:].any()
    assert run.waiting_ns.max() > 70_000_000


def test_a_lost_event_stays_wrong_until_the_next() -> None:
    run = run_events(steps(0, 500, 500, 500), NEWTON_PER_COUNT, 0.004)
    true = (steps(0, 500, 500, 500) * NEWTON_PER_COUNT).astype(np.float32)
    assert quality(true, run.updates)["longest_wrong_ms"] == 1
    assert quality(true, run.updates.kept(np.zeros(len(run.frame_of), np.bool_)))["longest_wrong_ms"] == 60


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_a_scan_brings_every_value_of_a_still_skin(bits: int) -> None:
    still = np.tile(np.random.default_rng(bits).random(4096, np.float32) * np.float32(0.02), (60, 1))
    run = run_scan(still, bits, 20.0)
    shown = run.updates.held(run.scan_ns, 4096).force_n[-1]
    assert np.abs(shown - still[0]).max() <= 0.51 * 0.02 / ((1 << bits) - 1)
    packed = run.sent.asked.frames
    assert packed["length"][: 4 * 32 * (bits // 2)].max() == 8


def test_sums_of_a_still_skin_and_a_lost_frame() -> None:
    contract = Contract.from_layout(load_layout())
    counts = np.tile(np.random.default_rng(1).integers(0, 1024, 4096).astype(np.int16), (30, 1))
    run = run_sums(contract, counts)
    exact = contract.phi.forward(counts[0].astype(np.int32)) * contract.layout.taxels.newton_per_count
    assert run.sums_n.shape == (3, 1024)
    np.testing.assert_allclose(run.sums_n[0], exact, rtol=1e-6, atol=1e-7)
    assert run.valid.all()
    assert run.closed_ns[0] == run.latency_ns[:256].max()
    lost = run_sums(contract, counts, loss_ratio=0.05, seed=3)
    assert 0 < (~lost.valid).sum() < lost.valid.size / 2
    assert ((~lost.valid).sum(axis=1) % 8 == 0).all()


def test_quality_of_known_errors() -> None:
    true = np.zeros((4, 16), np.float32)
    true[:, 3] = 0.01
    right = Images(np.array([1_500_000]), true[:1])
    found = quality(true, right)
    # Zeros are shown for two ticks: 10 log10(0.02² / (0.01² / 16)) dB.
    assert found["psnr_least_db"] == pytest.approx(10 * np.log10(64), abs=1e-4)
    assert found["psnr_peak_db"] == 71.0
    assert found["longest_wrong_ms"] == 2
    assert found["touched_error_mn"] == pytest.approx(10 * 0.5**0.5, rel=1e-6)
    late = Updates(np.array([2_000_000]), np.array([3]), np.array([0.01], np.float32))
    assert quality(true, late) == found
    assert quality(np.zeros_like(true), late)["touched_error_mn"] is None


def test_finer_and_smoother_images_keep_a_flat_touch() -> None:
    flat = Images(np.array([0, 10_000_000]), np.full((2, 1024), 0.005, np.float32))
    for order in (1, 3):
        np.testing.assert_allclose(refined(flat, order).force_n, 0.005, atol=1e-6)
    solved = smoothed(flat, 0.012)
    np.testing.assert_allclose(solved.force_n[-1], 0.005, atol=1e-4)
    assert solved.ready_ns.tolist() == [SOLVED_NS, 10_000_000 + SOLVED_NS]


def test_schemes_are_named_by_what_they_are() -> None:
    named: tuple[Scheme, ...] = (
        Sums(16),
        Sums(8),
        Scan(64, 10),
        Scan(32, 10, "solved", cells="mean"),
        Events(0.0025, 10, "solved"),
    )
    assert [(each.name, each.family) for each in named] == [
        ("sums, 16 bits", "sums"),
        ("sums, 8 bits", "sums"),
        ("scan, 10 bits", "scan"),
        ("32 x 32 means of 4 taxels, solved", "coarse"),
        ("events, 2.5 mN, 10 ms, solved", "events"),
    ]


@pytest.mark.heavy
@pytest.mark.parametrize("scheme", [Sums(16), Scan(64, 10), Events(0.004, 1)])
def test_what_is_measured_is_what_the_scheme_shows(scheme: Scheme) -> None:
    assert measure_scheme(scheme, SHORT, 1.0) == scheme.show(SHORT, 1.0).figures(SHORT.load())


@pytest.mark.heavy
@pytest.mark.parametrize("receiver", ["plain", "solved"])
def test_a_scan_takes_half_the_bits_at_half_the_share(receiver: Literal["plain", "solved"]) -> None:
    whole, half = (Scan(32, 10, receiver).show(Touch("nothing", ticks=1000), share) for share in (1.0, 0.5))
    assert whole.rate_hz == pytest.approx(2 * (half.rate_hz or 0))
    assert whole.sent.traffic()["kbit_per_s"] == pytest.approx(2 * half.sent.traffic()["kbit_per_s"], rel=0.03)
