"""``skin dbc`` writes the contract files; ``skin dbc-check`` finds their drift."""

import json
import sys
from pathlib import Path

import pytest

import dbc
from dbc.generate import DEFAULT_FOLDER
from shell.command import main
from tests.layouts import buses, layout_toml

# The arguments stand where the command finds them, in sys.argv.
pytestmark = pytest.mark.filterwarnings("ignore:Cyclopts application invoked without tokens")


PALM = layout_toml(8, 16, encoding={"sum_bits": 12, "offset_binary": True})


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["skin", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.mark.heavy
def test_committed_files_are_those_of_the_default_skin(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "dbc-check") == 0
    assert capsys.readouterr().out == ""
    assert {path.name for path in DEFAULT_FOLDER.iterdir()} == {f"bus{bus}.dbc" for bus in range(4)} | {"skin.eds"}


def test_check_names_the_files_that_drifted(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder, palm = tmp_path / "made" / "here", tmp_path / "palm.toml"
    palm.write_text(PALM)
    assert run(monkeypatch, "dbc", str(palm), "--out", str(folder), "--json") == 0
    assert json.loads(capsys.readouterr().out) == [str(folder / "bus0.dbc"), str(folder / "skin.eds")]
    assert run(monkeypatch, "dbc-check", str(palm), "--files", str(folder)) == 0
    text = (folder / "bus0.dbc").read_text()
    (folder / "bus0.dbc").write_text(text.replace("(16,-21840)", "(16,0)", 1))
    (folder / "skin.eds").unlink()
    (folder / "old.eds").write_text("")
    (folder / "notes.txt").write_text("mine")
    assert run(monkeypatch, "dbc-check", str(palm), "--files", str(folder)) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [Path(line.split()[0]).name for line in lines] == ["bus0.dbc", "old.eds", "skin.eds"]


def test_contract_writes_the_files_of_each_node_and_check_compares_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    layout, folder = tmp_path / "palm.toml", tmp_path / "palm"
    layout.write_text(layout_toml(8, 16, bus=buses(4, names=["arm"])))
    assert run(monkeypatch, "contract", str(layout), "--out", str(folder)) == 0
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    nodes = {f"nodes/arm-00{node}.{suffix}" for node in range(1, 5) for suffix in ("dcf", "json")}
    assert names == {"arm.dbc", "skin.eds", "vectors/arm-001.json"} | nodes
    assert capsys.readouterr().out.splitlines() == [str(folder / name) for name in sorted(names, key=order)]
    assert run(monkeypatch, "dbc-check", str(layout), "--files", str(folder)) == 0
    (folder / "nodes/arm-002.dcf").write_text("")
    (folder / "nodes/board.h").write_text("")
    (folder / "vectors/arm-001.json").unlink()
    assert run(monkeypatch, "dbc-check", str(layout), "--files", str(folder)) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [Path(line.split()[0]).name for line in lines] == ["arm-002.dcf", "arm-001.json"]


def order(name: str) -> tuple[bool, bool, str]:
    """Return the place of a file in the list: buses, types, nodes (table and DCF), vectors."""
    return name.startswith("vectors"), name.startswith("nodes"), name.replace("json", "a")


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["dbc"], "--out"),
        (["dbc-check", "fd"], "expected --files FOLDER"),
        (["dbc-check", "--files", "nowhere"], "nowhere: cannot read the contract files: No such file"),
        (["dbc", "nowhere.toml", "--out", "x"], "nowhere.toml: cannot read the layout"),
        (["dbc", str(Path(dbc.__file__)), "--out", "x"], "Expected '='"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(monkeypatch, *arguments) == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert len(shown.err.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.heavy
def test_folder_that_is_a_file_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    assert run(monkeypatch, "dbc", "--out", str(tmp_path / "file")) == 2
    assert "cannot write the files" in capsys.readouterr().err
