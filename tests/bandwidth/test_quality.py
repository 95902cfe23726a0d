"""How many sums are enough: simulated touches, image by image."""

import numpy as np
import pytest

from bandwidth.quality import qualities, quality
from canskin.errors import RunError
from skin.matrix import signs_of
from tests.layouts import small_boards, small_layout

MAT = small_layout(15, 17, sampling={"rate_hz": 1000.0})


def test_more_sums_give_better_images() -> None:
    own, *others = qualities(MAT, touches_s=3.0)
    assert own.sums == MAT.measurement.sums
    found = sorted([own, *others])
    assert [each.sums for each in found] == [16, 32, 64, 128, 256]
    assert [each.sums_per_taxel for each in found] == pytest.approx([each.sums / 255 for each in found])
    assert found[0].psnr_image_db < found[2].psnr_image_db < found[4].psnr_image_db
    assert found[0].touched_error_n > found[2].touched_error_n > found[4].touched_error_n
    assert found[4].psnr_image_db > found[4].psnr_sensor_db + 10
    assert len({(each.psnr_sensor_db, each.bound_sums) for each in found}) == 1  # the same touches and the same noise


def test_what_cannot_be_judged() -> None:
    with pytest.raises(RunError, match="nothing touched"):
        qualities(MAT, touches_s=0.1)


def test_a_matrix_is_judged_as_it_is() -> None:
    """Codes that change from frame to frame, one sum for five taxels."""
    codes = np.random.default_rng(1).integers(0, 2, (100, 20, 100))
    wire = small_layout(10, 10, measurement={"ensemble": "matrix", "matrix": signs_of(codes)})
    (found,) = qualities(wire, touches_s=3.0)
    assert (found.sums, found.sums_per_taxel) == (20, 0.2)
    assert found.psnr_image_db > found.psnr_sensor_db


def test_stepped_boards_send_on_simulated_buses() -> None:
    found = quality(small_boards(16, 10, 10), touches_s=3.0)
    assert found.psnr_image_db > found.psnr_sensor_db + 10
    assert found.touched_error_n < 1e-3
