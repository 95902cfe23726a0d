"""Each command and each Python block of the documents is run by a test, or is marked with the reason why not.

All commands are parsed, those of marked blocks and of running text, too: verbs, options, values, targets and files.
"""

import re
import shlex
import shutil
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib.metadata import metadata
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Final

import cyclopts
import numpy as np
import pytest
import trimesh

from dbc.contract import Contract
from docs import layout_keys
from docs.reference import PAGE, reference
from shell.command import build_app
from skin.layout import load_layout
from tests.descriptions import URDF, icub
from tests.documents import DOCUMENTS, REASONS, ROOT, Block, blocks
from tests.layouts import layout_toml
from tests.recording.helpers import SMALL, messages, write_log

COMMANDS: Final = [each for document in DOCUMENTS for each in blocks(document, "sh")]
#: Words in capitals stand for a value of the user.
_PLACEHOLDER: Final = re.compile(r"\b[A-Z]{1,5}\b")
#: Text between commands of one line.
_BETWEEN: Final = frozenset("&|;")
_VARIABLE: Final = re.compile(r"[A-Z_]+=")
_TAKEN: Final = re.compile(r'\bblock\(\s*"([\w./-]+)", "([^"]+)"')


def commands_of(line: str) -> Iterator[list[str]]:
    """Split a line of a shell into its commands."""
    tokens = shlex.shlex(line, posix=True, punctuation_chars="&|;")
    tokens.whitespace_split, tokens.commenters = True, "#"
    command: list[str] = []
    for token in tokens:
        if set(token) <= _BETWEEN:
            yield command
            command = []
        else:
            command.append(token)
    yield command


def is_of_skin(arguments: Sequence[str]) -> bool:
    if "--keys" in arguments:  # of every verb: the command line takes it before the verb's own options
        place = arguments.index("--keys")
        arguments = [*arguments[:place], *arguments[place + 2 :]]
    return not build_app(arguments).parse_args(arguments)[2]


def is_installed_from_here(arguments: Sequence[str]) -> bool:
    """Whether folders are distributions of ours, and the extras are declared."""
    extras = {extra for name in ("canskin", "canskin-client") for extra in metadata(name).get_all("Provides-Extra", [])}
    ours = [each.partition("[") for each in arguments if each.startswith(".")]
    return all((ROOT / path / "pyproject.toml").is_file() for path, *_ in ours) and all(
        extra in extras for _, _, named in ours for extra in filter(None, named.rstrip("]").split(","))
    )


def is_of_make(arguments: Sequence[str]) -> bool:
    text = (ROOT / "Makefile").read_text()
    targets = (each for each in arguments if "=" not in each)
    return all(re.search(rf"^{each}:", text, re.MULTILINE) for each in targets)


def is_of_pytest(arguments: Sequence[str]) -> bool:
    return all((ROOT / each).exists() for each in arguments if each.startswith("tests/"))


def is_of_install(arguments: Sequence[str]) -> bool:
    text = (ROOT / "deploy/install").read_text()
    return all(f"  {each}" in text for each in arguments if each.startswith("--"))


def is_of_docker(arguments: Sequence[str]) -> bool:
    text = (ROOT / "docker-compose.yml").read_text()
    profiles = (value for option, value in pairwise(arguments) if option == "--profile")
    return all(re.search(rf"profiles: \[.*{each}", text) for each in profiles)


def anything(_: Sequence[str]) -> bool:
    return True


#: Program of a command: whether it takes arguments. Programs of others are not asked.
PROGRAMS: Final[dict[str, Callable[[Sequence[str]], bool]]] = {
    "skin": is_of_skin,
    "make": is_of_make,
    "pip": is_installed_from_here,
    "pipx": is_installed_from_here,
    "docker": is_of_docker,
    "deploy/install": is_of_install,
    ".venv/bin/pytest": is_of_pytest,
    "python": is_of_pytest,
    **dict.fromkeys(
        (
            "arm-none-eabi-gcc",
            "arm-none-eabi-objcopy",
            "can_logger",
            "candump",
            "cc",
            "export",
            "git",
            "ip",
            "lerobot-record",
        ),
        anything,
    ),
    **dict.fromkeys(("printf", "ros2", "sleep", "skin-alive", "systemctl"), anything),
}


def is_known(command: list[str]) -> bool:
    """Whether the program of a command takes its arguments."""
    while command and (command[0] in ("sudo", "until", "do", "done") or _VARIABLE.match(command[0])):
        command = command[1:]
    return not command or (command[0] in PROGRAMS and PROGRAMS[command[0]](command[1:]))


@pytest.mark.parametrize("document", DOCUMENTS)
def test_commands_have_verbs_options_and_values_that_exist(document: str) -> None:
    for each in blocks(document, "sh"):
        for line in each.code.replace("\\\n", " ").splitlines():
            assert all(is_known(command) for command in commands_of(line)), f"{each}: {line}"
    for text in re.findall("`((?:skin|make) [^`]*)`", (ROOT / document).read_text("utf-8")):
        for command in commands_of(_PLACEHOLDER.sub("1", text)):
            try:
                assert is_known(command), f"{document}: {text}"
            except (cyclopts.MissingArgumentError, cyclopts.ConsumeMultipleError):
                """The text names a verb or an option alone."""


@pytest.mark.parametrize("document", DOCUMENTS)
def test_variables_of_the_environment_are_read(document: str) -> None:
    read = "".join(path.read_text("utf-8") for path in _sources())
    named = set(re.findall(r"\bSKIN_[A-Z_]+", "".join(each.code for each in blocks(document, "sh"))))
    assert [name for name in named if name not in read] == []


@cache
def _sources() -> list[Path]:
    tests = [path for path in (ROOT / "tests").rglob("*.py") if path.name != Path(__file__).name]
    return [*tests, ROOT / "docker-compose.yml", *(ROOT / "bus").glob("*.py")]


@pytest.mark.parametrize("document", DOCUMENTS)
def test_code_is_in_blocks_with_a_language(document: str) -> None:
    text = re.sub(r"^```.*?^```", "", (ROOT / document).read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    indented = re.findall(r"^    ((\S+) \S.*)$", text, re.MULTILINE)
    assert [line for line, word in indented if word in (*PROGRAMS, "import", "from")] == []


def test_blocks_that_are_not_run_here_say_why_or_where() -> None:
    unknown = [
        f"{each}: {each.mark}"
        for each in COMMANDS
        if each.mark and each.mark not in REASONS and each.document not in (ROOT / each.mark).read_text()
    ]
    assert unknown == []


def test_each_python_block_is_taken_by_a_test() -> None:
    taken = [found for path in (ROOT / "tests").rglob("test_*.py") for found in _TAKEN.findall(path.read_text("utf-8"))]
    for document in DOCUMENTS:
        for each in blocks(document, "python"):
            words = [word for name, word in taken if name == document]
            assert any(word in each.code for word in words), f"{each}: no test takes this block"


def test_each_picture_is_shown_and_has_its_command() -> None:
    text = "".join((ROOT / document).read_text("utf-8") for document in DOCUMENTS)
    shown = set(re.findall(r"!\[[^]]*\]\((?:docs/)?([^)]+)\)", text))
    assert shown == {path.name for ending in ("png", "svg") for path in (ROOT / "docs").glob(f"*.{ending}")}
    assert shown == set(re.findall(r'^    "([\w.-]+)": ', (ROOT / "docs/figures.py").read_text(), re.MULTILINE))


def test_the_keys_of_a_layout_are_those_of_the_code() -> None:
    text = layout_keys.PAGE.read_text("utf-8")
    assert layout_keys.page(text) == text, "run python -m docs.layout_keys"


def test_the_reference_is_that_of_the_code() -> None:
    assert PAGE.read_text("utf-8") == reference(), "run python -m docs.reference"


@pytest.mark.parametrize("document", DOCUMENTS)
def test_files_that_the_text_names_are_there(document: str) -> None:
    folders = "|".join(path.name for path in ROOT.iterdir() if path.is_dir())
    named = re.findall(rf"`((?:{folders})/[a-z_\d./-]+\.(?:py|md|c|h|js))`", (ROOT / document).read_text("utf-8"))
    assert [path for path in named if not (ROOT / path).exists()] == []


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files that commands of the documents name."""
    folder = tmp_path_factory.mktemp("documents")
    palm = folder / "palm.toml"
    palm.write_text(layout_toml(16, 16, **SMALL))
    contract = Contract.from_layout(load_layout(palm))
    shutil.copy(str(files("skin.layouts") / "forearm.csv"), folder / "fingertip.csv")
    (folder / "hand.urdf").write_text(URDF.format(order="row-major"))
    for made, name in zip(icub(folder, {0: "triangle_10pad"}), ("mesh.txt", "ini"), strict=True):
        made.rename(folder / f"left_forearm_{name}".replace("_ini", ".ini"))
    trimesh.creation.cylinder(30, 50).export(folder / "cup.stl")
    np.savez(folder / "mat.npz", force_n=np.zeros((3, 16, 16)))
    log = write_log(folder / "candump.log", messages(contract, np.zeros((4, contract.phi.shape[0]), np.int32)))
    replay = ["replay", str(log), "--layout", str(palm), "--out", str(folder / "run.mcap")]
    build_app(replay).meta(replay)
    return folder


@pytest.mark.parametrize("commands", [each for each in COMMANDS if not each.mark], ids=str)
def test_block_runs(commands: Block, prepared: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(prepared, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    for line in commands.code.splitlines():
        for program, *arguments in commands_of(line):
            assert program == "skin", f"{commands}: only commands of skin are run here"
            assert build_app(arguments).meta(arguments) in (None, 0), line


def rows_below(text: str, *words: str) -> list[list[str]]:
    """Return the cells of the first table whose head begins with `words`, without the line of dashes."""
    head = "| " + " | ".join(words)
    lines = text[text.index(head) :].split("\n\n", maxsplit=1)[0].splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert {len(row) for row in rows} == {len(rows[0])}
    return [rows[0], *rows[2:]]


def test_comparisons_of_the_readme_follow_from_the_table_of_rivals() -> None:
    """A row of the README reads "five slides: images | 47.6 dB, the default | 48.6 dB, the best scan"."""
    (_, *columns), *rivals = rows_below((ROOT / "docs/bandwidth.md").read_text("utf-8"), "scheme", "kbit/s")
    table = {name: dict(zip(columns, cells, strict=True)) for name, *cells in rivals}
    rows = rows_below((ROOT / "README.md").read_text("utf-8"), "what", "canskin", "others", "command")
    compared = [(what.partition(":")[0], figures) for what, *figures, command in rows if "evaluate rivals" in command]
    assert {column for column, _ in compared} >= {"five slides", "thirty drawn scenes"}
    for column, figures in compared:
        found = [each.split(" dB, ") for cell in figures for each in cell.split("; ")]
        assert [table[name][column].split()[0] for _, name in found] == [figure for figure, _ in found]
        assert {"the best scan", "the best scan at 460 kbit/s"} & {name for _, name in found}, "name the best rival"
