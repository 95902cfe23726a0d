"""Stepped nodes as processes: what they feel is shown, and every frame is accounted for."""

from pathlib import Path

import numpy as np
import pytest

from tests.layouts import STEPPED, buses, layout_toml
from tests.nodes.firmware.twins import needs_compiler
from tests.stepped_skin import resting_skin
from tests.system.helpers import report, skin


@pytest.mark.slow
def test_golf_ball_on_can_fd(tmp_path: Path) -> None:
    """Also where the taxels do not fill the blocks, the patches of boards are no rectangles, and the grid has gaps."""
    path = tmp_path / "small.toml"
    taxels = {"shape": [*["#" * 14 + "." * 4 + "#" * 14] * 8, *["#" * 30 + ".."] * 10]}
    bus = buses(17, fd=True, data_bitrate=5_000_000)
    path.write_text(layout_toml(18, 32, **STEPPED, name="small", taxels=taxels, bus=bus))
    options = ("--layout", str(path), "--objects", "golf-ball", "--seconds", "5", "--json", "--no-view")
    figures = report(skin("demo", *options, cwd=tmp_path))
    assert figures["sending"] == "steps"
    assert figures["frames_sent"] > 80
    # Images come late on a slow machine, and a ball that slides has moved by then: simulated buses have 53 dB.
    assert figures["psnr_image_db"] > figures["psnr_sensor_db"] + 6
    assert figures["label_accuracy"] >= 0.8
    assert 0 < figures["bus_load"][0] < 0.2
    assert (tmp_path / figures["picture"]).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
@pytest.mark.parametrize("options", [(), pytest.param(("--firmware",), marks=needs_compiler)], ids=["Python", "C"])
def test_a_gateway_that_follows_a_killed_one_shows_the_whole_touch(tmp_path: Path, options: tuple[str, ...]) -> None:
    with resting_skin(tmp_path) as started:
        started.start_bus()
        started.start("nodes", *options)
        for _ in range(2):
            started.start("gateway")
            held_n = started.await_rest()
            assert started.is_true(held_n)
            assert np.count_nonzero(held_n[:, 0]) >= 4
            started.kill("gateway")
