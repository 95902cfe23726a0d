"""``skin touch dataset``: made, taken up, mended, interrupted, in several processes."""

import contextlib
import os
import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from tests.processes import PATIENCE_S
from touch.datasets.command import dataset
from touch.datasets.options import AcquisitionOptions, ClassificationOptions, TaxelOptions

FEW = ClassificationOptions(arrays="8,1", perturbations=3)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*.npy")}


def listed(manifest: Path) -> int:
    return len(msgspec.json.decode(manifest.read_bytes())["chunks"]) if manifest.exists() else 0


@pytest.mark.heavy
def test_one_and_two_processes_make_the_same_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for jobs in (1, 2):
        dataset("classification", out=tmp_path / str(jobs), objects="cup,tuna-can", touches=FEW, jobs=jobs, json=True)
    first, second = (msgspec.json.decode(line) for line in capsys.readouterr().out.splitlines())
    assert first["files"] == first["files_made"] == second["files_made"] == 8
    assert first["objects"]["cup"]["made_of"] == "own shape"
    assert first["bytes"] == sum(map(len, contents(tmp_path / "1").values()))
    assert contents(tmp_path / "1") == contents(tmp_path / "2")


@pytest.mark.heavy
def test_a_second_run_makes_only_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def run() -> str:
        dataset("acquisition", out=tmp_path, objects="golf-ball", slides=AcquisitionOptions(speed=3), jobs=1)
        return capsys.readouterr().out

    assert "4 files made" in run()
    whole = contents(tmp_path)
    (tmp_path / "golf-ball" / "sensor-01.npy").write_bytes(b"damaged")
    assert "2 files made" in run()
    assert contents(tmp_path) == whole
    assert "0 files made" in run()


def test_taxels_reach_the_sensor_signal(tmp_path: Path) -> None:
    taxels = TaxelOptions(noise_n=0.0, defect=["dead=0.25", "cross-talk=0.1", "gain-spread=0.1"])
    dataset("classification", out=tmp_path, objects="volleyball", touches=FEW, taxels=taxels, seed=4, jobs=1)
    true, sensor = (np.load(tmp_path / "averaged-08x08" / f"volleyball-{name}.npy") for name in ("true", "sensor"))
    dead = (sensor == 0).all(axis=0)
    assert dead.sum() >= 16
    assert not np.array_equal(sensor[:, ~dead], true[:, ~dead])
    settings = msgspec.json.decode((tmp_path / "manifest.json").read_bytes())["settings"]
    assert settings["dead"] == {"ratio": 0.25, "seed": 4}
    assert settings["damper"] is None


def test_wrong_options_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="belong to 'classification'"):
        dataset("acquisition", out=tmp_path, touches=FEW)
    with pytest.raises(InputError, match="belong to 'acquisition'"):
        dataset("classification", out=tmp_path, slides=AcquisitionOptions(speed=2))
    with pytest.raises(InputError, match=r"numbers with commas between.*'8,big'"):
        dataset("classification", out=tmp_path, touches=ClassificationOptions(arrays="8,big"))
    with pytest.raises(InputError, match="1 job or more"):
        dataset("classification", out=tmp_path, objects="cup", touches=FEW, jobs=0)
    with pytest.raises(InputError, match="ratio needs a number from 0 to 1"):
        dataset("classification", out=tmp_path, taxels=TaxelOptions(defect=["dead=2"]))
    with pytest.raises(InputError, match="a touch of seconds does not show it"):
        dataset("classification", out=tmp_path, taxels=TaxelOptions(defect=["creep"]))


@pytest.mark.slow
def test_ctrl_c_is_quiet_and_the_run_goes_on_later(tmp_path: Path) -> None:
    """The whole foreground group gets the signal, as from a terminal."""
    folder, manifest = tmp_path / "slides", tmp_path / "slides" / "manifest.json"
    command = [sys.executable, "-m", "skin", "touch", "dataset", "acquisition"]
    command += ["--out", folder, "--objects", "granola-box,cup"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([*command, "--jobs", "2"], **pipes, start_new_session=True) as run:  # type: ignore[call-overload]
        while run.poll() is None and not listed(manifest):
            with contextlib.suppress(subprocess.TimeoutExpired):
                run.wait(0.05)
        os.killpg(run.pid, signal.SIGINT)
        out, err = run.communicate(timeout=PATIENCE_S)
    assert (run.returncode, out, err) == (130, b"", b"")
    before = listed(manifest)
    done = subprocess.run([*command, "--jobs", "2", "--json"], capture_output=True, check=True, timeout=PATIENCE_S)
    summary = msgspec.json.decode(done.stdout)
    assert summary["files"] == 24
    assert summary["files_made"] == 24 - before
