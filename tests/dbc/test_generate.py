"""The contract files: which there are, and what is said of those that are others."""

from pathlib import Path

import pytest

from canskin.errors import InputError
from dbc.contract import Contract
from dbc.generate import contract_files, drifted, node_files, write_files
from skin.layout import load_layout
from tests.layouts import buses, small_layout

FILES = Path(__file__).parents[2] / "dbc/files/default"


@pytest.mark.heavy
def test_the_default_skin_has_the_files_of_the_project() -> None:
    files = contract_files(Contract.from_layout(load_layout()))
    assert sorted(files) == ["bus0.dbc", "bus1.dbc", "bus2.dbc", "bus3.dbc", "skin.eds"]
    for name, text in files.items():
        assert text.splitlines() == (FILES / name).read_text("ascii").splitlines()
    assert drifted(files, FILES) == []


def test_every_node_has_a_table_and_a_dcf() -> None:
    files = node_files(Contract.from_layout(small_layout(bus=buses(2, names=["arm"]))))
    assert sorted(files) == [f"nodes/arm-00{node}.{suffix}" for node in (1, 2) for suffix in ("dcf", "json")]


def test_files_that_differ_are_missing_or_too_many_are_named(tmp_path: Path) -> None:
    wanted = {"a.dbc": "a", "b.eds": "b", "nodes/c.json": "c", "nodes/d.dcf": "d", "vectors/e.json": "e"}
    written = write_files(wanted, tmp_path / "made")
    assert written == [tmp_path / "made" / name for name in wanted]
    assert [path.read_bytes() for path in written] == [b"a", b"b", b"c", b"d", b"e"]
    assert drifted(wanted, tmp_path / "made") == []
    for name in ("x.txt", "nodes/y.h", "z.json"):  # others may lie there
        (tmp_path / "made" / name).write_text("")
    (tmp_path / "made/a.dbc").unlink()
    (tmp_path / "made/nodes/d.dcf").write_text("e")
    (tmp_path / "made/vectors/f.json").write_text("")
    made = tmp_path / "made"
    assert drifted(wanted, made) == [
        f"{made}/a.dbc is missing",
        f"{made}/nodes/d.dcf differs from what the layout makes of it",
        f"{made}/vectors/f.json does not belong to this layout",
    ]


def test_folders_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file: cannot write the files: "):
        write_files({"a.dbc": ""}, tmp_path / "file")
    with pytest.raises(InputError, match=r"none: cannot read the contract files: No such file or directory"):
        drifted({}, tmp_path / "none")
