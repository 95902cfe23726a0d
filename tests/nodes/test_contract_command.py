"""``skin contract`` writes the files for boards, and finds their drift."""

import json
import sys
from pathlib import Path

import pytest

import dbc
from dbc.program import Program
from tests.layouts import buses, layout_toml
from tests.processes import Verb


@pytest.fixture
def palm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    layout = layout_toml(8, 16, bus=buses(4, names=["arm"]), encoding={"sum_bits": 12, "offset_binary": True})
    Path("palm.toml").write_text(layout)
    return "palm.toml"


def test_contract_writes_all_files_and_check_names_those_that_drifted(palm: str, skin: Verb) -> None:
    folder = Path("made/here")
    code, out, _ = skin("contract", palm, "--out", folder, "--json")
    assert code == 0
    nodes = {f"nodes/arm-00{node}.{suffix}" for node in range(1, 5) for suffix in ("dcf", "json")}
    made = {"arm.dbc", "skin.eds", "vectors/arm-001.json"} | nodes
    assert {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()} == made
    assert set(json.loads(out)) == {str(folder / name) for name in made}
    check = "contract", palm, "--out", folder, "--check"
    assert skin(*check)[0] == 0
    text = (folder / "arm.dbc").read_text()
    (folder / "arm.dbc").write_text(text.replace("(16,-21840)", "(16,0)", 1))
    for name in ("skin.eds", "vectors/arm-001.json"):
        (folder / name).unlink()
    for name in ("old.eds", "notes.txt", "nodes/arm-002.dcf", "nodes/board.h"):
        (folder / name).write_text("")
    code, out, _ = skin(*check)
    assert code == 1
    drifted = [str(Path(line.split()[0]).relative_to(folder)) for line in out.splitlines()]
    assert drifted == ["arm.dbc", "nodes/arm-002.dcf", "old.eds", "skin.eds", "vectors/arm-001.json"]


def test_firmware_takes_the_place_of_these_files(palm: str, skin: Verb) -> None:
    assert skin("contract", palm, "--firmware", "--node", "arm:2", "--out", "firmware")[0] == 0
    assert {path.name for path in Path("firmware").iterdir()} == {"README.md", "boards", "ports", "src"}
    assert {path.name for path in Path("firmware/boards").iterdir()} == {"arm-002"}


def test_program_gets_the_header_that_boards_ask_for(palm: str, skin: Verb) -> None:
    Path("main.bin").write_bytes(b"code")
    code, out, _ = skin("contract", palm, "--program", "main.bin", "--release", "1.1", "--out", "new.bin")
    assert code == 0
    program = Program.read(Path("new.bin"))
    assert (program.version, program.data) == ("1.1", b"code")
    assert f"{program.identification:08X}h" in out


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], "expected --out"),
        (["palm.toml", "--check"], "expected --out"),
        (["--check", "--firmware", "--out", "x"], "expected one of --check, --firmware and --program"),
        (["--node", "bus0:1", "--out", "x"], "expected --node with --firmware alone"),
        (["--program", "palm.toml", "--out", "x"], "expected --program FILE and --release VERSION together"),
        (["--program", "palm.toml", "--release", "1.1 of May", "--out", "x"], "expected 1 to 8 printable characters"),
        (
            ["--program", sys.executable, "--release", "1.1", "--out", "x"],
            "got an ELF file: objcopy",
        ),
        (["--program", "nowhere", "--release", "1.1", "--out", "x"], "nowhere: cannot read the program"),
        (["--check", "--out", "nowhere"], "nowhere: cannot read the contract files: No such file"),
        (["nowhere.toml"], "nowhere.toml: cannot read the layout"),
        (["--out", "palm.toml"], "cannot write the files"),
        ([str(Path(dbc.__file__)), "--out", "x"], "Expected '='"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(palm: str, arguments: list[str], said: str, skin: Verb) -> None:
    code, _, told = skin("contract", *arguments)
    assert code == 2
    assert said in told
    assert len(told.splitlines()) == 1
    assert [path.name for path in Path().iterdir()] == [palm]
