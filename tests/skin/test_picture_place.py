"""Where a picture may be saved."""

from pathlib import Path

import pytest

from skin.errors import InputError
from skin.picture_place import check_place


@pytest.mark.parametrize(
    ("name", "says"),
    [("none/x.png", "folder"), ("x", r"\.png, "), ("x.docx", "got '.docx'"), ("folder.png", "cannot write")],
)
def test_place_that_cannot_be_used_is_told_before_the_run(name: str, says: str, tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(InputError, match=says):
        check_place(tmp_path / name)
