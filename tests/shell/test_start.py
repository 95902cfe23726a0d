"""What a verb loads before it runs: libraries that only some of its options need would make each start late."""

import subprocess
import sys

import pytest

from shell.command import VERBS

SCIPY = ("scipy.linalg", "scipy.ndimage", "scipy.sparse", "scipy.spatial", "scipy.special", "numpy.f2py", "pywt")
VIEWS = ("numba", "scipy", "can", "canopen", "sklearn", "pywt")
#: Modules that a verb does not load, by verb.
UNUSED = {
    "bus": (*SCIPY, "can", "canopen", "mcap"),
    "nodes": (*SCIPY, "mcap"),
    "gateway": (*SCIPY, "can", "canopen", "mcap"),
    "reconstruct": (*SCIPY, "can", "canopen", "mcap"),
    "record": (*SCIPY, "can", "canopen"),
    "doctor": (*SCIPY, "can", "canopen"),
    **dict.fromkeys(("classify", "view", "monitor", "metrics", "list", "ros2", "hub"), VIEWS),
}
LOAD = """
import gc, importlib, sys
import shell.command
importlib.import_module(sys.argv[1])
kernels = [each for each in gc.get_objects() if type(each).__name__ == "CPUDispatcher" and each.overloads]
print(*(name for name in sys.argv[2:] if name in sys.modules), *(each.__name__ for each in kernels))
"""


@pytest.mark.heavy
@pytest.mark.parametrize("verb", UNUSED)
def test_a_verb_loads_what_it_uses_and_no_kernel(verb: str) -> None:
    words = [sys.executable, "-c", LOAD, VERBS[verb].partition(":")[0], *UNUSED[verb]]
    loaded = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    assert loaded.split() == []
