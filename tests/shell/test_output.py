"""Where a picture may be saved, and files that are there as a whole or not at all."""

import errno
import io
from pathlib import Path
from typing import Any

import pytest

from canskin.errors import InputError
from shell.output import PICTURE_SUFFIXES, cache_folder, check_output_path, write_file


@pytest.mark.parametrize(
    ("name", "says"),
    [("none/x.png", "folder"), ("x", r"\.png, "), ("x.docx", "got '.docx'"), ("folder.png", "cannot write")],
)
def test_path_that_cannot_be_used_is_told_before_the_run(name: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(InputError, match=says):
        check_output_path(tmp_path / name, "picture", *PICTURE_SUFFIXES)


def test_file_is_replaced_and_keeps_its_link_and_mode(tmp_path: Path) -> None:
    file, link = tmp_path / "palm.toml", tmp_path / "link.toml"
    write_file(file, "Φ")
    file.chmod(0o640)
    link.symlink_to(file)
    write_file(link, b"new")
    assert link.is_symlink()
    assert (file.read_bytes(), file.stat().st_mode & 0o777) == (b"new", 0o640)
    assert sorted(each.name for each in tmp_path.iterdir()) == ["link.toml", "palm.toml"]


def test_full_disk_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Full(io.FileIO):
        def write(self, data: Any) -> int:
            super().write(data[: len(data) // 2])
            raise OSError(errno.ENOSPC, "No space left on device")

    file = tmp_path / "palm.dbc"
    write_file(file, "old")
    monkeypatch.setattr(Path, "open", lambda path, mode: Full(path, mode))  # noqa: PLW0108 - a class would not bind
    for path in (file, tmp_path / "other.dbc"):
        with pytest.raises(OSError, match="No space left"):
            write_file(path, "new and longer")
    monkeypatch.undo()
    assert [each.name for each in tmp_path.iterdir()] == ["palm.dbc"]
    assert file.read_text() == "old"


def test_device_is_written_and_not_replaced(tmp_path: Path) -> None:
    write_file(Path("/dev/null"), "anything")
    assert Path("/dev/null").is_char_device()
    with pytest.raises(OSError, match="Is a directory"):
        write_file(tmp_path, "anything")


def test_cache_folder_follows_the_environment() -> None:
    assert cache_folder({"SKIN_CACHE": "/a", "XDG_CACHE_HOME": "/b"}) == Path("/a")
    assert cache_folder({"XDG_CACHE_HOME": "/b"}) == Path("/b/canskin")
    assert cache_folder({}) == Path.home() / ".cache" / "canskin"
