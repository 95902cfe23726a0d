"""`make docs`: every link leads somewhere, and every docstring can be read."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_has_every_document(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    for document in (ROOT / "docs").glob("*.md"):
        assert (tmp_path / document.stem / "index.html").is_file()
    home = (tmp_path / "index.html").read_text("utf-8")
    assert 'href="firmware/"' in home
    assert "SkinError" in (tmp_path / "api" / "canskin" / "index.html").read_text("utf-8")
