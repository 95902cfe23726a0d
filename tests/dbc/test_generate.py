"""The contract files of the default skin, and what is said of files that are others."""

from pathlib import Path

import pytest

from dbc.contract import Contract
from dbc.generate import DEFAULT_FOLDER, contract_files, drifted, write_files
from skin.layout import load_layout


@pytest.mark.heavy
def test_committed_files_are_those_of_the_default_skin() -> None:
    assert drifted(contract_files(Contract.from_layout(load_layout())), DEFAULT_FOLDER) == []
    assert {path.name for path in DEFAULT_FOLDER.iterdir()} == {f"bus{bus}.dbc" for bus in range(4)} | {"skin.eds"}


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
