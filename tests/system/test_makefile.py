"""What `make` says and leaves behind when the Python is too old, and what the demo's environment holds."""

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "client").mkdir()
    for name in ("Makefile", "pyproject.toml", "client/pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path / name)
    old = tmp_path / "old-python"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo "Python 3.10.12" && exit 0\nexit 1\n')
    old.chmod(0o755)
    return tmp_path


def make(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["make", *arguments], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("goal", ["demo", "test"])
def test_python_that_is_too_old_is_named_and_leaves_nothing(goal: str, folder: Path) -> None:
    done = make(folder, goal, "PYTHON=./old-python")
    assert done.returncode == 2
    assert done.stderr.startswith("canskin needs Python 3.11 or newer, and './old-python' is Python 3.10.12;")
    assert not (folder / ".venv").exists()


def test_environment_that_cannot_be_used_is_made_anew(folder: Path) -> None:
    broken = folder / ".venv/bin/python"
    broken.parent.mkdir(parents=True)
    shutil.copy(folder / "old-python", broken)
    new = folder / "new-python"  # its venv has no pip, so that nothing is installed here
    new.write_text('#!/bin/sh\n[ "$1" = -m ] && echo "$@" > venv-call\nexit 0\n')
    new.chmod(0o755)
    assert make(folder, "demo", "PYTHON=./new-python").returncode == 2
    assert (folder / "venv-call").read_text() == "-m venv --clear .venv\n"
    assert not list(folder.glob(".venv/.*"))


def test_demo_installs_no_test_tools(folder: Path) -> None:
    assert '--editable "."' in make(folder, "-n", "demo").stdout
    assert '--editable ".[test]"' in make(folder, "-n", "setup").stdout
