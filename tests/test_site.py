"""`make docs`: every link leads somewhere, every page is in the table of contents, and every docstring can be read."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import canskin
from docs.site_pages import ROOT, write


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_has_every_document(tmp_path: Path) -> None:
    write(tmp_path)
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--config-file", str(tmp_path / "mkdocs.yml")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    site = tmp_path / "site"
    pages = {path.parent: path.read_text("utf-8") for path in site.rglob("index.html")}
    assert {path.stem for path in (ROOT / "docs").glob("*.md")} <= {path.name for path in pages}
    reached = {(site / link).resolve() for link in re.findall(r'href="([\w./-]+/)"', pages[site])}
    assert set(pages) - reached <= {site}
    assert [str(path) for path, page in pages.items() if "```" in page or "sh needs" in page] == []
    api = pages[site / "api" / "canskin"]
    assert [name for name in canskin.__all__ if f'id="canskin.{name}"' not in api] == []
