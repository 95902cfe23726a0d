"""A folder of recordings as arrays: on this machine and on a cluster, what is made again, and errors."""

import os
import signal
from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError, RunError
from recording.replay_command import replay
from recording.replay_folder import MANIFEST, Made
from shell.parallel import in_parallel
from tests.layouts import small_layout
from tests.recordings import write_touches

LAYOUT = small_layout()


def write(path: Path, seed: int) -> Path:
    force_n = np.zeros((1, LAYOUT.taxels.rows, LAYOUT.taxels.columns), np.float32)
    force_n[0, 2:5, 2 + seed % 3 : 5] = 0.5
    return write_touches(path, LAYOUT, force_n, ["-"], seed=seed)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recordings")
    for seed in range(6):
        write(folder / f"run{seed}.mcap", seed)
    return folder


def manifest(out: Path) -> dict[str, Made]:
    return msgspec.json.decode((out / MANIFEST).read_bytes(), type=dict[str, Made])


def images(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(out.glob("*.npz"))}


def test_what_is_missing_is_made(folder: Path, tmp_path: Path) -> None:
    runs, out = tmp_path / "runs", tmp_path / "images"
    runs.mkdir()
    for path in sorted(folder.iterdir())[:2]:
        (runs / path.name).write_bytes(path.read_bytes())
    (runs / "torn.mcap").write_bytes(b"no recording")
    with pytest.raises(RunError, match="1 of 3 recordings gave no images"):
        replay(runs, out=out, jobs=1)
    made = manifest(out)
    assert [bool(each.error) for each in made.values()] == [False, False, True]
    with np.load(out / "run0.npz") as file:
        assert file["images"].shape == (made["run0.mcap"].images, LAYOUT.taxels.rows, LAYOUT.taxels.columns)
    (runs / "torn.mcap").unlink()
    write(runs / "torn.mcap", 7)
    (out / "run1.npz").write_bytes(b"damaged")
    replay(runs, out=out, jobs=1)
    again = manifest(out)
    assert again["run0.mcap"] == made["run0.mcap"]  # its seconds are those of the first run
    assert again["run1.mcap"].images_sha256 == made["run1.mcap"].images_sha256
    assert not again["torn.mcap"].error
    replay(runs, out=out, jobs=1, gains=None, tare="never")
    assert manifest(out) == again


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes_though_a_worker_is_killed(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed", reason="NOT TESTED: a cluster, for want of distributed")
    replay(folder, out=tmp_path / "here", jobs=1)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
    ) as cluster:
        victim = next(iter(cluster.workers.values())).pid

        def first_kills(calls: list[Callable[[], Made]], jobs: str) -> object:
            for number, each in enumerate(in_parallel(calls, jobs)):
                if number == 0:
                    os.kill(victim, signal.SIGKILL)
                yield each

        monkeypatch.setattr("recording.replay_folder.in_parallel", first_kills)
        replay(folder, out=tmp_path / "there", cluster=cluster.scheduler_address)
    assert len(images(tmp_path / "there")) == 6
    assert images(tmp_path / "there") == images(tmp_path / "here")


def test_wrong_calls(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="expected recordings of 'skin record'"):
        replay(tmp_path / "empty", out=tmp_path / "out")
    with pytest.raises(InputError, match="is a folder: expected --out FOLDER"):
        replay(folder)
    with pytest.raises(InputError, match="for a folder of recordings"):
        replay(folder / "run0.mcap", out=tmp_path / "out.npz", jobs=2)
    monkeypatch.setattr("shell.parallel.PATIENCE_S", 0.1)
    with pytest.raises(RunError, match="no scheduler answers"):
        replay(folder, out=tmp_path / "out", cluster="tcp://127.0.0.1:9")
    (tmp_path / "out" / MANIFEST).write_text("{")
    with pytest.raises(InputError, match="expected the manifest"):
        replay(folder, out=tmp_path / "out", jobs=1)
