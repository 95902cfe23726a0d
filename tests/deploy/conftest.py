"""Installations below folders of the tests, with the environment of the tests."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
Install = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def install() -> Install:
    """``deploy/install --root ROOT`` with more words."""

    def run(root: Path, *words: str) -> subprocess.CompletedProcess[str]:
        venv = [] if "--remove" in words else ["--venv", sys.prefix]
        command = [str(ROOT / "deploy/install"), "--root", str(root), *venv, *words]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=240)

    return run


@pytest.fixture(scope="session")
def installed(install: Install, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The root of an installation of the default layout on skin0 to skin3."""
    root = tmp_path_factory.mktemp("root")
    done = install(root, "--interface", "skin0", "--adapter", "skin0=0042A7", "skin1=0042A7:1")
    assert done.returncode == 0, done.stderr
    return root
