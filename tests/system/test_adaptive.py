"""Adaptive nodes as processes: what they feel is shown, and every frame is accounted for."""

from pathlib import Path

import numpy as np
import pytest

from tests.adaptive_skin import resting_skin
from tests.layouts import ADAPTIVE, buses, layout_toml
from tests.nodes.firmware.twins import needs_compiler
from tests.system.helpers import report, skin


@pytest.mark.slow
def test_golf_ball_on_can_fd(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text(layout_toml(16, 32, **ADAPTIVE, name="small", bus=buses(16, fd=True, data_bitrate=5_000_000)))
    options = ("--layout", str(path), "--objects", "golf-ball", "--seconds", "5", "--json", "--no-view")
    figures = report(skin("demo", *options, cwd=tmp_path))
    assert figures["sending"] == "adaptive"
    assert figures["frames_sent"] > 80
    # Images come late on a slow machine, and a ball that slides has moved by then: simulated buses have 53 dB.
    assert figures["psnr_image_db"] > figures["psnr_sensor_db"] + 6
    assert figures["label_accuracy"] >= 0.8
    assert 0 < figures["bus_load"][0] < 0.2
    assert (tmp_path / figures["picture"]).read_bytes().startswith(b"\x89PNG")


@needs_compiler
@pytest.mark.slow
def test_boards_in_c_show_a_touch_that_rests(tmp_path: Path) -> None:
    with resting_skin(tmp_path) as started:
        started.start_bus()
        started.start("nodes", "--firmware")
        started.start("gateway")
        held_n = started.await_rest()
        assert started.is_true(held_n)
        assert np.count_nonzero(held_n[:, 0]) >= 4


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), pytest.param(("--firmware",), marks=needs_compiler)], ids=["Python", "C"])
def test_a_gateway_that_follows_a_killed_one_shows_the_whole_touch(tmp_path: Path, options: tuple[str, ...]) -> None:
    with resting_skin(tmp_path) as started:
        started.start_bus()
        started.start("nodes", *options)
        started.start("gateway")
        started.await_rest()
        started.kill("gateway")
        started.start("gateway")
        assert started.is_true(started.await_rest())
