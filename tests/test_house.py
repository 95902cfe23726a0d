"""The house itself: every package is ours, and no file grows into two."""

import importlib.metadata
import importlib.util
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"][
    "packages"
]


@pytest.mark.parametrize("package", PACKAGES)
def test_package_resolves_inside_this_distribution(package: str) -> None:
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    assert Path(spec.origin).is_relative_to(ROOT)


def test_every_folder_of_code_is_a_listed_package() -> None:
    folders = {path.parent.name for path in ROOT.glob("*/__init__.py")} - {"tests"}
    assert folders == set(PACKAGES)


def test_command_is_installed() -> None:
    scripts = importlib.metadata.entry_points(group="console_scripts", name="skin")
    assert [script.value for script in scripts] == ["skin.command:main"]


def test_no_file_is_over_400_lines() -> None:
    long = [
        str(path.relative_to(ROOT))
        for package in [*PACKAGES, "tests"]
        for path in (ROOT / package).rglob("*.py")
        if len(path.read_text().splitlines()) > 400
    ]
    assert not long
