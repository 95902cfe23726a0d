"""Simulated sums: noise, clipping, ADC, Φ."""

import msgspec
import numpy as np
import pytest

from classifier.features import Float32
from classifier.newest_sums import NewestSums, averaged_cycles
from classifier.samples import FALSE_ALARM_RATIO, observe_untouched, simulate_means, simulate_sums
from skin.layout import Layout
from skin.phi import Sbhe


def test_without_noise_sums_are_phi_of_the_counts(layout: Layout, phi: Sbhe) -> None:
    rng = np.random.default_rng(0)
    force_n: Float32 = rng.uniform(-0.01, 0.03, (300, 32, 32)).astype(np.float32)
    counts = np.rint(np.clip(force_n, 0, np.float32(0.02)) / layout.taxels.newton_per_count).astype(int)
    sums = simulate_sums(force_n, layout, phi, 0.0, rng)
    assert sums.dtype == np.int32
    np.testing.assert_array_equal(sums, phi.forward(counts.reshape(300, -1)))
    assert counts.max() == 1023


def test_noise_has_the_asked_deviation(layout: Layout, phi: Sbhe) -> None:
    force_n = np.full((200, 32, 32), 0.01, np.float32)  # mid-range: nothing is clipped
    noise_n = np.where(np.arange(200) < 100, 0.001, 0.0005)
    sums = simulate_sums(force_n, layout, phi, noise_n, np.random.default_rng(1))
    plain = sums[:, phi.row_of_sum != 0] * layout.taxels.newton_per_count / np.sqrt(phi.block_size)
    np.testing.assert_allclose(plain[:100].std(), 0.001, rtol=0.02)
    np.testing.assert_allclose(plain[100:].std(), 0.0005, rtol=0.02)


@pytest.mark.heavy
def test_threshold_is_passed_as_often_as_stated(layout: Layout, phi: Sbhe) -> None:
    one = observe_untouched(layout, phi, 0.001, 3000, np.random.default_rng(0))
    other = observe_untouched(layout, phi, 0.001, 3000, np.random.default_rng(1))
    assert FALSE_ALARM_RATIO == 0.002
    np.testing.assert_allclose(one.contact_threshold, other.contact_threshold, atol=1.2)
    np.testing.assert_allclose(one.no_touch, other.no_touch, rtol=0.1)


def test_analogue_sums_have_the_noise_of_their_taxels_unclipped(layout: Layout, phi: Sbhe) -> None:
    replace = msgspec.structs.replace
    analogue = replace(layout, taxels=replace(layout.taxels, frontend="analogue"))
    sums = simulate_sums(np.zeros((200, 32, 32), np.float32), analogue, phi, 0.001, np.random.default_rng(1))
    assert not (sums % phi.block_size).any()
    found_n = sums * layout.taxels.newton_per_count
    np.testing.assert_allclose(found_n.std(), 0.001 * phi.block_size**0.5, rtol=0.02)
    np.testing.assert_allclose(found_n[:, phi.row_of_sum == 0].mean(), 0, atol=3e-4)


@pytest.mark.parametrize("turns", [1, 2])
def test_simulated_means_are_those_of_the_classifier(layout: Layout, phi: Sbhe, turns: int) -> None:
    """Also in sums of all taxels of a block, which clipped noise shifts; untouched, faint, at the end of the range."""
    quick = msgspec.structs.replace(layout, sync=msgspec.structs.replace(layout.sync, rate_hz=250.0, turns=turns))
    force_n = np.zeros((32, 32), np.float32)
    force_n[:8], force_n[8:12] = 0.0199, 0.0005
    rng = np.random.default_rng(2)
    cycles = averaged_cycles(quick)
    assert cycles == 10
    held = np.broadcast_to(force_n, (600, 32, 32))
    newest, came, live = NewestSums(phi, cycles), np.ones(phi.blocks, np.bool_), []
    sent = np.zeros(phi.shape[0], np.int32)
    for cycle, sums in enumerate(simulate_sums(held, quick, phi, 0.001, rng)):
        sent[cycle % turns :: turns] = sums[cycle % turns :: turns]
        newest.take(sent, came, 1)
        live.append(newest.sums.copy())
    means = simulate_means(held, quick, phi, 0.001, rng)
    np.testing.assert_allclose(means.mean(axis=0), np.mean(live[50:], axis=0), atol=0.8 * means.std(axis=0).max())
    np.testing.assert_allclose(means.std(axis=0).mean(), np.std(live[50:], axis=0).mean(), rtol=0.1)
