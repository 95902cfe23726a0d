"""Known gains of taxels are taken off the images."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from canskin.messages import Image
from reconstructor.gains import GainCorrection, KnownGains
from reconstructor.imaging import CycleImager, load_gains, make_imager
from reconstructor.service import ReconstructorService
from skin.calibration_file import encoded, new_calibration
from skin.defects import Defects, Stage, SumGains
from skin.frontend import with_gains
from skin.layout import Sampling, load_layout
from skin.psnr import psnr_db
from tests.messages import Published
from tests.reconstructor.helpers import LAYOUT, measurement, pixels

SAMPLED_ONCE = msgspec.structs.replace(LAYOUT, sampling=Sampling())
SHAPE = (LAYOUT.taxels.rows, LAYOUT.taxels.columns)
GAINS = np.random.default_rng(1).normal(1, 0.1, SHAPE).clip(0.5)


def psnr_of_a_slide(gains: np.ndarray, known: np.ndarray | None) -> float:
    images = Published()
    taken_off = None if known is None else KnownGains(known)
    service = ReconstructorService(LAYOUT, CycleImager(SAMPLED_ONCE, gains=taken_off), images)
    i, j = np.indices(SHAPE)
    for cycle in range(20):
        true_n = (0.012 * np.exp(-((i - 30) ** 2 + (j - 20 - cycle / 2) ** 2) / 30)).astype(np.float32)
        service.take(measurement(cycle, true_n * gains))
    return psnr_db(true_n, pixels(images.of(Image)[-1]), LAYOUT.taxels.force_max_n)


def test_gains_cost_little_when_they_are_known() -> None:
    without = psnr_of_a_slide(np.ones(SHAPE), None)
    unknown, known = psnr_of_a_slide(GAINS, None), psnr_of_a_slide(GAINS, GAINS.ravel())
    assert unknown < without - 4
    assert known > without - 1


def test_gains_come_from_a_calibration(tmp_path: Path) -> None:
    path = tmp_path / "gains.json"
    path.write_bytes(encoded(new_calibration(LAYOUT, gains=GAINS.ravel())))
    loaded = load_gains(path, LAYOUT)
    np.testing.assert_array_equal(loaded.taxels, GAINS.ravel())
    assert loaded.sums is None
    path.write_bytes(encoded(new_calibration(LAYOUT, offsets_n=np.zeros(LAYOUT.measurement.sums))))
    with pytest.raises(InputError, match="has no gains of taxels"):
        load_gains(path, LAYOUT)
    with pytest.raises(InputError, match="synchronous"):
        make_imager(load_layout(Path("steps")), gains=path)


def test_known_gains_of_analogue_sums_are_taken_off() -> None:
    """At rest what is left is the sums of Φ, as soon as the image is that of the forces."""
    phi, random = LAYOUT.phi(), np.random.default_rng(5)
    force_n = random.uniform(0, 0.02, phi.shape[1]).astype(np.float32)
    (of_sums,) = Defects.of({"mismatch": 0.05}, 2).effects(Stage.SUM_PATHS, phi.shape[:1])
    read_n = (GAINS.ravel() * force_n).astype(np.float32)
    exact_n = np.asarray(phi.forward(force_n), np.float32)
    sums_n = with_gains(phi, read_n, np.asarray(phi.forward(read_n), np.float32), of_sums)
    correction = GainCorrection(phi, KnownGains(GAINS.ravel(), of_sums))
    correction.keep(force_n.reshape(SHAPE))
    np.testing.assert_allclose(correction.apply(sums_n, np.ones(phi.shape[0], np.bool_))[0], exact_n, atol=2e-6)
    assert np.abs(sums_n - exact_n).max() > 5e-3


def test_dead_analogue_sums_have_no_part_in_the_image() -> None:
    phi, random = LAYOUT.phi(), np.random.default_rng(7)
    other, total = 5, int(np.flatnonzero(phi.row_of_sum == 0)[0])
    of_sums = SumGains(np.ones(phi.shape[0]), np.zeros(phi.shape[0]))
    of_sums.differential[[other, total]] = 0.01, 0.5  # as a roll finds them: of the row of all ones D + C alone
    of_sums.common_mode[total] = -0.5
    images = Published()
    imager = CycleImager(SAMPLED_ONCE, gains=KnownGains(np.ones(phi.shape[1]), of_sums))
    service = ReconstructorService(LAYOUT, imager, images)
    for cycle in range(20):
        counts = np.rint(random.normal(0, 1, phi.shape[0])).astype("<i4")
        made = measurement(cycle, np.zeros(SHAPE, np.float32))
        service.take(msgspec.structs.replace(made, sums=counts.tobytes()))
    message = images.of(Image)[-1]
    assert message.valid_sums == phi.shape[0] - 2
    assert pixels(images.of(Image)[-1]).max() < 1e-3
