"""What is said of contract files that are others."""

from pathlib import Path

from dbc.generate import drifted, write_files


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
