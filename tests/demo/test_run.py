"""The end of a run: its picture, its summary, and an interruption."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from demo.folder import PREFIX
from demo.run import Run, summary
from demo.score import Score, Snapshot
from demo.wishes import Wishes
from skin.layout import load_layout
from tests.processes import Processes

LAYOUT = load_layout()


def run_with_contact(picture: Path, folder: Path) -> Run:
    wishes = Wishes(None, 1.0, None, None, (), "", 0, view=False, port=None, picture=picture)
    run = Run(LAYOUT, wishes, folder)
    force_n = np.full((64, 64), 0.01, np.float32)
    run._score.shown = Snapshot(force_n, force_n, force_n)
    return run


def test_picture_that_cannot_be_written_after_all_is_a_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report: dict[str, Any] = {"sensor_adds_noise": True}
    assert run_with_contact(tmp_path / "here.png", tmp_path).save_picture(report)
    assert report["picture"] == str(tmp_path / "here.png")
    del report["picture"]
    assert not run_with_contact(tmp_path / "gone" / "x.png", tmp_path).save_picture(report)
    assert "picture" not in report
    assert "cannot write the picture" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("adds_noise", "expected"),
    [
        (True, "51.6 dB, against the sensor's 26.0 dB, over 7 contact cycles"),
        (False, "51.6 dB, against what was played, which has no noise, over 7 contact cycles"),
    ],
)
def test_summary_compares_with_a_sensor_that_adds_noise(adds_noise: bool, expected: str) -> None:
    figures = {"psnr_image_db": 51.6, "psnr_sensor_db": 26.0, "sensor_adds_noise": adds_noise, "contact_cycles": 7}
    assert dict(summary(Score(LAYOUT).report() | figures))["image"] == expected


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interruption_before_the_first_cycle_has_no_summary(number: signal.Signals, tmp_path: Path) -> None:
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-m", "skin", "demo", "--no-view"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=tmp_path
    )
    try:
        Processes(tmp_path).until(lambda: bool(list(tmp_path.glob(f"{PREFIX}*/bus.log"))), "a process of the run")
        process.send_signal(number)
        out, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 130
    assert said.strip().splitlines()[-1] == "demo: interrupted before the first cycle"
    assert not out
    assert not list(tmp_path.iterdir())
