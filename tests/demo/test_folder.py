"""The folder of a run, and those that killed runs have left."""

import fcntl
import os
from pathlib import Path

import pytest

from demo import folder as folder_module
from demo.folder import PREFIX, run_folder


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def test_folder_lasts_as_long_as_the_run(temporary: Path) -> None:
    with run_folder() as folder:
        assert folder.parent == temporary
        (folder / "bus.log").touch()
    assert not list(temporary.iterdir())


def test_folders_of_the_dead_are_removed_and_no_others(temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder_module, "GRACE_S", -1.0)
    left, elsewhere = temporary / f"{PREFIX}left", temporary / "elsewhere"
    for each in (left, elsewhere):
        each.mkdir()
        (each / "bus.log").touch()
    (temporary / f"{PREFIX}link").symlink_to(elsewhere)
    (temporary / f"{PREFIX}file").touch()
    with run_folder() as first, run_folder() as second:
        assert first.is_dir()
        assert second.is_dir()
        assert not left.exists()
        assert (elsewhere / "bus.log").exists()


def test_folder_too_young_to_be_claimed_is_left_alone(temporary: Path) -> None:
    young = temporary / f"{PREFIX}young"
    young.mkdir()
    with run_folder():
        assert young.exists()


def test_folder_is_claimed_while_the_run_lasts(temporary: Path) -> None:
    with run_folder() as folder:
        other = os.open(folder, os.O_RDONLY)
        with pytest.raises(BlockingIOError):
            fcntl.flock(other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.close(other)
