"""Kernels on disk: used again while nothing changed, compiled anew when anything that was compiled in did."""

import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from numba import int64
from numba.core import event

from shell.compiled import njit

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
PAIR = """
class Pair(NamedTuple):
    a: int
    b: int
"""
OF_TUPLE = """
from shapes import Shape
from shell.compiled import njit

@njit(cache=True)
def first(pair):
    return pair.a

print(first(Shape(a=1, b=2)), sum(first.stats.cache_hits.values()))
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "caller.py").write_text(CALLER)
    return tmp_path


def result(folder: Path, *, factor: int, constant: str) -> list[int]:
    """Write the callee, and return what `told` does."""
    (folder / "callee.py").write_text(CALLEE.format(factor=factor, constant=constant))
    return told(folder)


def told(folder: Path, **environment: str) -> list[int]:
    """Run the caller, and return its result and how often the cache had it."""
    # Python takes its own bytecode of a file for that of a later one of the same size and the same second.
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **environment}
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
@pytest.mark.parametrize("later", [PAIR.replace("Pair", "Couple"), PAIR.replace("a: int\n    b", "b: int\n    a")])
def test_a_kernel_is_compiled_anew_when_a_tuple_of_another_file_has_other_fields_or_another_name(
    folder: Path, later: str
) -> None:
    shapes = "from typing import NamedTuple\n{}\nShape = {}\n"
    (folder / "caller.py").write_text(OF_TUPLE)
    for definition, kept in ((PAIR, 0), (PAIR, 1), (later, 0)):
        (folder / "shapes.py").write_text(shapes.format(definition, definition.split()[1].partition("(")[0]))
        assert told(folder) == [1, kept]


@pytest.mark.heavy
def test_a_kernel_is_compiled_in_memory_where_no_folder_can_be_written(folder: Path) -> None:
    (folder / "callee.py").write_text(CALLEE.format(factor=2, constant="SHIFT = 10"))
    (folder / "__pycache__").touch()  # no folder can be made of that name, by root neither
    assert told(folder, **NOWHERE) == [12, 0]
    assert [path.name for path in folder.glob("**/*.nb*")] == []


def test_two_threads_may_call_a_kernel_with_a_signature_first() -> None:
    @njit(int64(int64))
    def doubled(x: int) -> int:
        return 2 * x

    results: list[int] = []
    other = threading.Thread(target=lambda: results.append(doubled(2)))

    class Meanwhile(event.Listener):
        def on_start(self, _: Any) -> None:
            other.start()

        def on_end(self, _: Any) -> None:
            pass

    with event.install_listener("numba:compile", Meanwhile()):
        results.append(doubled(1))
    other.join()
    assert sorted(results) == [2, 4]
