"""Writes the pages of the site of `make docs`: the documents, the README as home page, docstrings of each package."""

import re
import shutil
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
#: Documents beside the code, and their names on the site.
BESIDE: Final = {
    "README.md": "index.md",
    "nodes/firmware/c/README.md": "boards-in-c.md",
    "nodes/firmware/c/steps/README.md": "stepped-boards.md",
    "nodes/firmware/c/slave/README.md": "bus-services-of-boards.md",
}
#: A document that the text names, and a file beside the documents that the README links to.
_NAMED: Final = re.compile(r"`docs/([\w-]+\.md)`")
_LINKED: Final = re.compile(r"\]\(docs/")
#: The mark of a block says to `tests/documents.py` who runs the block.
_MARK: Final = re.compile(r"^(```\w+) .*$", re.MULTILINE)


def write(folder: Path) -> None:
    """Write the pages and their settings, `mkdocs.yml`, into a folder; the site is built in `site/` of it."""
    pages = folder / "docs"
    shutil.rmtree(folder, ignore_errors=True)
    (pages / "api").mkdir(parents=True)
    documents = {path.name: path for path in (ROOT / "docs").glob("*.md")}
    for name, path in (documents | {name: ROOT / path for path, name in BESIDE.items()}).items():
        (pages / name).write_text(_linked(path.read_text("utf-8")), "utf-8")
    for picture in (*(ROOT / "docs").glob("*.png"), *(ROOT / "docs").glob("*.svg")):
        shutil.copy(picture, pages)
    api = []
    for package in packages():
        api.append(f"api/{package.name}.md")
        modules = "\n".join(f"::: {name}" for name in modules_of(package))
        (pages / api[-1]).write_text(f"# {package.name}\n\n{modules}\n", "utf-8")
    settings = (ROOT / "docs" / "site.yml").read_text("utf-8").replace("ROOT", str(ROOT))
    (folder / "mkdocs.yml").write_text(f"{settings}  - API: [{', '.join(api)}]\n", "utf-8")


def _linked(text: str) -> str:
    """Make links of the documents that a text names, and leave out the marks of the blocks."""
    for path, name in BESIDE.items():
        text = text.replace(f"](../{path})", f"]({name})")
    return _NAMED.sub(r"[`\1`](\1)", _LINKED.sub("](", _MARK.sub(r"\1", text)))


def packages() -> list[Path]:
    """Return the folders of the packages, the client first."""
    found = (each.parent for each in ROOT.glob("*/py.typed"))
    return [ROOT / "client" / "canskin", *sorted(found)]


def modules_of(package: Path) -> list[str]:
    """Return the names of the public modules of a package, that of the package first."""
    paths = (each.relative_to(package.parent) for each in package.rglob("*.py"))
    names = (".".join(each.with_suffix("").parts).removesuffix(".__init__") for each in paths)
    return sorted(name for name in names if "._" not in name)


if __name__ == "__main__":
    write(Path(sys.argv[1]))
