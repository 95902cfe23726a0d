"""Features and peak of sums whose noise differs from that of the training."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from classifier.features import widths_for
from classifier.observer import Observer
from classifier.samples import observe_untouched
from skin.layout import Layout
from skin.phi import Sbhe
from tests import surfaces


@pytest.mark.parametrize("noise_ratio", [1.0, 2.0, 4.5])
def test_an_untouched_skin_looks_the_same_whatever_its_noise_when_that_is_told(
    layout: Layout, phi: Sbhe, noise_ratio: float
) -> None:
    rng = np.random.default_rng(5)
    no_touch = observe_untouched(layout, phi, 0.001, 400, rng).no_touch
    observer = Observer(phi, layout.taxels.surface, no_touch)
    # Counts of taxels without an end of their range: noise alone, in proportion.
    sums = phi.forward(rng.normal(0, 0.001 / layout.taxels.newton_per_count, (400, layout.taxels.count)))
    widths, whole = len(widths_for(layout.taxels.surface)), np.ones(phi.blocks, np.float32)

    def seen(ratio: float) -> tuple[float, np.ndarray]:
        peaks, energies = [], []
        for one in sums:
            peaks.append(observer.look(ratio * one, whole, 1.0, ratio))
            energies.append(np.sinh(observer.features[:widths]))
        return float(np.mean(peaks)), np.mean(energies, axis=0) / ratio**2

    expected, found = seen(1.0), seen(noise_ratio)
    assert found[0] == pytest.approx(expected[0], rel=1e-3)
    assert found[1] == pytest.approx(expected[1], rel=1e-3)


def test_features_and_peak_are_relative_to_the_untouched_skin(phi: Sbhe) -> None:
    """A quarter of the blocks gives a quarter of the energy, and half the peak."""
    energy_mean, energy_sd, peak_mean, peak_sd = np.array([[4.0, 1.0], [2.0, 4.0], [0.5, 8.0], [0.25, 2.0]])
    observer = Observer(phi, surfaces.grid(32, 32), np.array([energy_mean, energy_sd, peak_mean, peak_sd]))
    seen: list[tuple[Any, ...]] = []
    smoothed: Any = SimpleNamespace(
        measure=lambda *given: seen.append(given), energies=np.array([40.0, 3.0]), peaks=np.array([6.0, 0.1])
    )
    observer.smoothed = smoothed
    sums, valid = np.zeros(phi.shape[0]), np.ones(phi.blocks, np.float32)
    peak = observer.look(sums, valid, 0.25, 2.0)
    assert [given[2] for given in seen] == [0.25]
    energies = [(40.0 - 4 * 4.0) / 2.0 / 0.25, (3.0 - 4 * 1.0) / 4.0 / 0.25]
    peaks = [6.0 / 0.5 / 0.5, 0.05]  # the second is below a twentieth of its mean
    assert observer.features.tolist() == pytest.approx([*np.arcsinh(energies), *np.log(peaks)])
    assert peak == pytest.approx((6.0 / 2 - 0.5) / 0.25)
    assert observer.look(sums, valid, 0.25) == pytest.approx((6.0 - 0.5) / 0.25)
