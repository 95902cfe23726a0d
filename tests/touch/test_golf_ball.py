"""The golf ball's trajectory: closed form, and its row of the paper's Table I."""

from functools import cache

import numpy as np
import numpy.typing as npt
import pytest

from touch.contact import Grid, Pose, press
from touch.objects import spheres_of
from touch.trajectory import PAPER_DEPTH_M, PAPER_STEPS, paper_pose

#: Ball and taxel radius together, metres.
REACH_M = 0.04267 / 2 + 0.002


def closed_form(step: int) -> npt.NDArray[np.float64]:
    pressing, sliding = min(step, 1099), max(0, step - 1099)
    depth = max(0.0, (pressing - 100) * 1e-5)
    axis = (np.arange(64) - 31.5) * 0.004
    x, y = 0.06 - 2e-5 * sliding, 0.06 - 4e-5 * sliding
    squared = (axis[None, :] - x) ** 2 + (axis[:, None] - y) ** 2
    force: npt.NDArray[np.float64] = np.maximum(0.0, depth - REACH_M + np.sqrt(np.maximum(0.0, REACH_M**2 - squared)))
    return force


@cache
def trajectory() -> npt.NDArray[np.float32]:
    ball = spheres_of("golf-ball")
    return np.stack([press(Grid(), [(ball, paper_pose(step))]) for step in range(PAPER_STEPS)])


def test_force_equals_the_closed_form() -> None:
    steps = [*range(0, PAPER_STEPS, 37), 99, 100, 101, 1099, 1100, 4199]
    worst = max(float(np.abs(trajectory()[step] - closed_form(step)).max()) for step in steps)
    assert worst < 1e-9


def test_contact_has_the_paper_files_size() -> None:
    contact = (trajectory() > 0).sum(axis=(1, 2))
    assert round(contact.mean()) == 63
    assert contact.max() == 76
    assert trajectory().max() <= np.float32(PAPER_DEPTH_M)


def test_poses_of_the_paper() -> None:
    assert paper_pose(0).depth_m == paper_pose(100).depth_m == 0.0
    assert paper_pose(1099) == Pose(0.06, 0.06, 0.0, PAPER_DEPTH_M)
    assert pytest.approx((-0.002, -0.064, 0.0, 0.00999)) == paper_pose(4199)[:4]
    assert paper_pose(9999) == paper_pose(4199)
    assert paper_pose(-5) == paper_pose(0)
    assert paper_pose(1100, (0.02, 0.0), 3.0)[:3] == pytest.approx((0.02 - 2e-5, -4e-5, 3.0))
