"""Kernels on disk: used again while nothing changed, compiled anew when anything that was compiled in did."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CALLEE = """
from shell.compiled import njit

{constant}

@njit(cache=True)
def scaled(x):
    return {factor} * x
"""
#: Of a process that finds no folder to write to.
NOWHERE = {"NUMBA_CACHE_DIR": "/proc/cache", "HOME": "/proc/home", "XDG_CACHE_HOME": "/proc/cache"}
CALLER = """
from callee import SHIFT, scaled
from shell.compiled import njit

@njit(cache=True)
def shifted(x):
    return scaled(x) + SHIFT

print(shifted(1), sum(shifted.stats.cache_hits.values()))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "caller.py").write_text(CALLER)
    return tmp_path


def result(folder: Path, *, factor: int, constant: str) -> list[int]:
    """Write the callee, run the caller, and return its result and how often the cache had it."""
    (folder / "callee.py").write_text(CALLEE.format(factor=factor, constant=constant))
    # Python takes its own bytecode of a file for that of a later one of the same size and the same second.
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    command = [sys.executable, "caller.py"]
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True, text=True, env=environment)
    return [int(word) for word in done.stdout.split()]


@pytest.mark.heavy
def test_a_kernel_is_compiled_anew_when_what_it_calls_or_names_in_another_file_changes(
    folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    assert result(folder, factor=2, constant="SHIFT = 10") == [12, 0]
    assert result(folder, factor=2, constant="SHIFT = 10") == [12, 1]
    copy = shutil.copytree(folder, tmp_path_factory.mktemp("copies") / "copy")
    assert result(copy, factor=2, constant="SHIFT = 10") == [12, 1]
    assert result(folder, factor=3, constant="SHIFT = 10") == [13, 0]
    assert result(folder, factor=3, constant="SHIFT = 20") == [23, 0]


@pytest.mark.heavy
def test_a_kernel_is_compiled_in_memory_where_no_folder_can_be_written(folder: Path) -> None:
    (folder / "callee.py").write_text(CALLEE.format(factor=2, constant="SHIFT = 10"))
    (folder / "__pycache__").touch()  # no folder can be made of that name, by root neither
    done = subprocess.run(
        [sys.executable, "caller.py"],
        cwd=folder,
        check=True,
        capture_output=True,
        text=True,
        env={**os.environ, **NOWHERE},
    )
    assert done.stdout == "12 0\n"
    assert [path.name for path in folder.glob("**/*.nb*")] == []
