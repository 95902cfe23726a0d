"""``skin demo`` as a user runs it, and every wrong input with one clear line."""

import json
import os
import socket
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests import layouts
from tests.system.conftest import Command
from tests.system.helpers import report, skin


def check_frames(figures: dict[str, Any], of_a_cycle: int) -> None:
    """Check that every frame of every cycle is accounted for, and that no cycle that lacks frames counts as complete.

    A node that a busy host wakes after the synchronous window sends nothing, and counts its frames as dropped.
    """
    cycles, complete = figures["cycles"], figures["cycles_complete"]
    assert of_a_cycle * complete <= figures["frames_sent"]
    assert figures["frames_sent"] + figures["frames_dropped"] <= of_a_cycle * cycles
    assert max(figures["frames_dropped"], figures["frames_missing"]) <= of_a_cycle * (cycles - complete)


@pytest.mark.slow
def test_golf_ball(slow_layout: Path, tmp_path: Path) -> None:
    options = ("--layout", str(slow_layout), "--objects", "golf-ball", "--seconds", "6", "--json", "--no-view")
    figures = report(skin("demo", *options, cwd=tmp_path))
    check_frames(figures, of_a_cycle=256)
    assert figures["cycles"] > 60
    assert figures["psnr_image_db"] > figures["psnr_sensor_db"] + 1
    assert figures["label_accuracy"] >= 0.8
    # A gateway that a busy host wakes late leaves periods out.
    assert 10 < figures["sync_rate_hz"] < 20 * 1.05
    # 64 frames of 111 to 135 bits, a SYNC, and heartbeats, at most 20 times a second.
    ratio = figures["cycles_complete"] / figures["cycles"] * figures["sync_rate_hz"] / 20
    assert len(figures["bus_load"]) == 4
    for load in figures["bus_load"]:
        assert 0.9 * ratio * 64 * 111 * 20e-6 < load < (64 * 135 + 66) * 20e-6 + 0.01
    picture = tmp_path / figures["picture"]
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_recording(tmp_path: Path) -> None:
    """A recording in counts, without classifier, on two larger skins whose taxels do not fill the blocks."""
    rows, columns = np.mgrid[0:17, 0:12]
    frames = [3000 * np.exp(-((rows - 8) ** 2 + (columns - 3 - step) ** 2) / 20) for step in range(6)]
    np.savez(tmp_path / "mat.npz", standing=np.zeros((3, 17, 12), np.uint16), lying=np.round(frames).astype(np.uint16))
    rates = {"sampling": {"rate_hz": 20.0}, "sync": {"rate_hz": 20.0}}
    for name in ("mat", "seat"):
        (tmp_path / f"{name}.toml").write_text(layouts.layout_toml(17, 23, name=name, **rates))
    touch = ("--input", "mat.npz", "--array", "lying", "--full-scale", "4095")
    less = ("--seconds", "3", "--json", "--no-view", "--no-classify")
    done = skin("demo", "--layout", "mat.toml", "--layout", "seat.toml", *touch, *less, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    both = json.loads(done.stdout)
    assert list(both) == ["mat", "seat"]
    for name, figures in both.items():
        assert figures["frames_lost"] == 0
        assert "classifier" not in figures["cpu_ratio"]
        check_frames(figures, of_a_cycle=26)
        assert figures["nodes_missing"] == []
        assert figures["psnr_sensor_db"] > 60
        assert figures["psnr_image_db"] > 25
        assert figures["label_accuracy"] is None
        assert figures["picture"] == str(tmp_path / f"skin-demo-{name}.png")


@pytest.mark.slow
def test_recordings_given_from_outside(slow_layout: Path, tmp_path: Path) -> None:
    """Real recordings, when ``SKIN_DATA`` names the folder that holds ``pressure-mat``."""
    folder = os.environ.get("SKIN_DATA")
    if folder is None:
        pytest.skip("NOT TESTED: real pressure recordings, for want of SKIN_DATA")
    options = ("--input", f"{folder}/pressure-mat/S1.npz", "--array", "posture_01", "--array", "posture_02")
    common = ("--layout", str(slow_layout), "--full-scale", "4095", "--seconds", "3", "--json", "--no-view")
    figures = report(skin("demo", *options, *common, cwd=tmp_path))
    assert figures["psnr_image_db"] > 30


@pytest.fixture
def wrong_files(tmp_path: Path) -> Path:
    np.save(tmp_path / "flat.npy", np.zeros((5, 10)))
    np.save(tmp_path / "large.npy", np.zeros((5, 100, 100)))
    np.save(tmp_path / "nan.npy", np.full((5, 8, 8), np.nan))
    np.save(tmp_path / "objects.npy", np.array([{}], dtype=object), allow_pickle=True)
    (tmp_path / "broken.npz").write_bytes(b"PK\x03\x04 no archive")
    (tmp_path / "words.csv").write_text("a,b\nc,d\n")
    (tmp_path / "unknown.toml").write_text("[taxels]\nheight = 3\n")
    (tmp_path / "model.npz").write_bytes(b"no model")
    return tmp_path


@pytest.mark.parametrize(
    "arguments",
    [
        ("demo", "--input", "missing.npz"),
        ("demo", "--input", "flat.npy"),
        ("demo", "--input", "large.npy"),
        ("demo", "--input", "nan.npy"),
        ("demo", "--input", "objects.npy"),
        ("demo", "--input", "broken.npz"),
        ("demo", "--input", "words.csv"),
        ("demo", "--layout", "missing.toml"),
        ("demo", "--layout", "unknown.toml"),
        ("demo", "--objects", "unicorn"),
        ("demo", "--model", "model.npz"),
        ("demo", "--seconds", "0"),
        ("demo", "--seconds", "soon"),
        ("demo", "--picture", "no/folder/x.png"),
        ("demo", "--picture", "x.docx"),
        ("demo", "--unknown-flag"),
        ("nodes", "--only", "bus9:1"),
        ("nodes", "--only", "bus0:33"),
        ("nodes", "--noise-n", "nan"),
        ("nodes", "--seed", "-1"),
        ("nodes", "-i", "socketcan", "-c", "a", "-c", "b"),
        ("classify", "--layout", "default", "--model", "model.npz"),
        ("classify", "--layout", "default", "--model", "missing.npz"),
        ("unknown-verb",),
    ],
    ids=" ".join,
)
def test_wrong_input_is_one_line_and_exit_code_2(
    arguments: tuple[str, ...], wrong_files: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    quiet = ("--no-view", "--seconds", "1") if arguments[0] == "demo" and "--seconds" not in arguments else ()
    monkeypatch.chdir(wrong_files)
    said = command(*arguments, *quiet)
    assert said.returncode == 2, said.stderr
    assert not said.stdout
    lines = [line for line in said.stderr.splitlines() if line.strip()]
    assert len(lines) == 1, said.stderr
    assert lines[0].startswith("skin: ")


def test_port_in_use(command: Command) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        done = command("demo", "--port", str(taken.getsockname()[1]), "--seconds", "1")
    assert done.returncode == 2
    assert "in use" in done.stderr
    assert "Traceback" not in done.stderr
