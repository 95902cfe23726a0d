"""Known gains of taxels are taken off the images."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.stored import save_calibration, store
from canskin.errors import InputError
from canskin.fabric import Mailbox
from canskin.messages import IMAGE, Topic
from reconstructor.command import load_gains
from reconstructor.engine import Reconstructor
from reconstructor.gains import GainCorrection, KnownGains
from reconstructor.service import ReconstructorService
from skin.defects import Mismatch
from skin.frontend import with_gains
from skin.layout import load_layout
from skin.psnr import psnr_db
from tests.reconstructor.test_service import LAYOUT, measurement

SHAPE = (LAYOUT.taxels.rows, LAYOUT.taxels.columns)
GAINS = np.random.default_rng(1).normal(1, 0.1, SHAPE).clip(0.5)


class Images:
    """Takes what a service publishes."""

    def __init__(self) -> None:
        self.made: list[np.ndarray] = []

    def publish(self, topic: Topic, message: Any) -> None:
        if topic is IMAGE:
            self.made.append(np.frombuffer(message.pixels, "<f4").reshape(SHAPE))

    def mailbox(self, topic: Topic, depth: int = 4) -> Mailbox:
        return Mailbox(depth)


def psnr_of_a_slide(gains: np.ndarray, known: np.ndarray | None) -> float:
    images = Images()
    taken_off = None if known is None else KnownGains(known)
    service = ReconstructorService(LAYOUT, Reconstructor(LAYOUT.phi(), *SHAPE), images, gains=taken_off)
    i, j = np.indices(SHAPE)
    for cycle in range(20):
        true_n = (0.012 * np.exp(-((i - 30) ** 2 + (j - 20 - cycle / 2) ** 2) / 30)).astype(np.float32)
        service.take(measurement(cycle, true_n * gains))
    return psnr_db(true_n, images.made[-1], LAYOUT.taxels.force_max_n)


def test_gains_cost_little_when_they_are_known() -> None:
    without = psnr_of_a_slide(np.ones(SHAPE), None)
    unknown, known = psnr_of_a_slide(GAINS, None), psnr_of_a_slide(GAINS, GAINS.ravel())
    assert unknown < without - 4
    assert known > without - 1


def test_gains_come_from_a_calibration(tmp_path: Path) -> None:
    path = tmp_path / "gains.json"
    save_calibration(path, store(LAYOUT, gains=GAINS.ravel()))
    loaded = load_gains(path, LAYOUT)
    assert loaded is not None
    np.testing.assert_array_equal(loaded.taxels, GAINS.ravel())
    assert loaded.sums is None
    assert load_gains(None, LAYOUT) is None
    save_calibration(path, store(LAYOUT, offsets_n=np.zeros(LAYOUT.measurement.sums)))
    with pytest.raises(InputError, match="has no gains of taxels"):
        load_gains(path, LAYOUT)
    with pytest.raises(InputError, match="synchronous"):
        load_gains(path, load_layout(Path("adaptive"), adaptive=True))


def test_known_gains_of_analogue_sums_are_taken_off() -> None:
    """At rest what is left is the sums of Φ, as soon as the image is that of the forces."""
    phi, random = LAYOUT.phi(), np.random.default_rng(5)
    force_n = random.uniform(0, 0.02, phi.shape[1]).astype(np.float32)
    of_sums = Mismatch(0.05, seed=2).gains(phi.shape[0])
    read_n = (GAINS.ravel() * force_n).astype(np.float32)
    exact_n = np.asarray(phi.forward(force_n), np.float32)
    sums_n = with_gains(phi, read_n, np.asarray(phi.forward(read_n), np.float32), of_sums)
    correction = GainCorrection(phi, KnownGains(GAINS.ravel(), of_sums))
    correction.keep(force_n.reshape(SHAPE))
    np.testing.assert_allclose(correction.apply(sums_n), exact_n, atol=2e-6)
    assert np.abs(sums_n - exact_n).max() > 5e-3
