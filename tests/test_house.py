"""The house itself: every package is ours, no import hides from the import rules, and no file grows into two."""

import ast
import importlib.metadata
import importlib.util
import re
import tomllib
from collections.abc import Iterator
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


def test_all_distributions_are_of_one_version() -> None:
    client = tomllib.loads((ROOT / "client/pyproject.toml").read_text())["project"]
    for path in (ROOT / "pyproject.toml", *ROOT.glob("client/*/pyproject.toml")):
        other = tomllib.loads(path.read_text())["project"]
        assert other["version"] == client["version"]
        assert f"canskin-client=={client['version']}" in other["dependencies"]


def test_integrations_import_nothing_of_the_application() -> None:
    found = {
        name.split(".")[0]
        for path in ROOT.glob("client/*/*/*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        for name in (
            [node.module or ""]
            if isinstance(node, ast.ImportFrom)
            else [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else []
        )
    }
    assert found
    assert not found & set(PACKAGES)


def test_command_is_installed() -> None:
    scripts = importlib.metadata.entry_points(group="console_scripts", name="skin")
    assert [script.value for script in scripts] == ["shell.command:main"]


#: Where one package reaches another by name: entry points, and the verbs of the command line.
BY_NAME = {"skin/sources.py", "shell/command.py"}
#: What imports a module by its name.
IMPORTERS = {
    "__import__",
    "entry_points",
    "exec_module",
    "import_module",
    "module_from_spec",
    "run_module",
    "run_path",
    "spec_from_file_location",
}
IMPORTER_MODULES = {"pkgutil", "runpy", "importlib.machinery"}
OWN_PLACE = re.compile(rf"({'|'.join([*PACKAGES, 'canskin'])})(\.\w+)*:\w+")


def hidden_imports(tree: ast.AST) -> Iterator[str]:
    """Find what could import a module that no import statement names, and names of our own modules with a member."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node.id in IMPORTERS:
            yield node.id
        elif isinstance(node, ast.Attribute) and node.attr in IMPORTERS:
            yield node.attr
        elif isinstance(node, ast.ImportFrom):
            names = {alias.name for alias in node.names}
            yield from sorted(names & IMPORTERS)
            if node.module in IMPORTER_MODULES:
                yield node.module
        elif isinstance(node, ast.Import):
            yield from sorted({alias.name for alias in node.names} & IMPORTER_MODULES)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and OWN_PLACE.fullmatch(node.value):
            yield node.value


@pytest.mark.heavy
def test_no_import_hides_from_the_import_rules() -> None:
    files = {path.relative_to(ROOT): path for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
    found = {name.as_posix(): set(hidden_imports(ast.parse(path.read_text()))) for name, path in files.items()}
    # The verbs of the evaluation, which may import everything, load one of its parts when it is asked for.
    may = BY_NAME | {name.as_posix() for name in files if name.parts[0] == "evaluation" and name.name == "command.py"}
    assert not {name: hidden for name, hidden in found.items() if hidden and name not in may}


def test_no_test_imports_from_another_test() -> None:
    among_tests = re.compile(r"^from tests\.[\w.]*\btest_", re.MULTILINE)
    assert not [path for path in ROOT.glob("tests/**/*.py") if among_tests.search(path.read_text())]


@pytest.mark.parametrize(
    "code",
    [
        "import importlib\nimportlib.import_module('touch.sources')",
        "from importlib.metadata import entry_points",
        "from importlib import import_module as load",
        "import runpy",
        "__import__('touch.sources')",
        "import pkgutil as tools",
        "find('touch.sources:objects')",
    ],
)
def test_a_hidden_import_is_found(code: str) -> None:
    assert list(hidden_imports(ast.parse(code)))
    assert not list(hidden_imports(ast.parse("from importlib.metadata import version\nimport touch.sources")))
