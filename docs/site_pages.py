"""Pages of the site that no file holds: the home page is the README, and each package has a page of its docstrings."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

ROOT: Final = Path(__file__).parents[1]
#: Documents beside the code, and their names on the site.
BESIDE: Final = {
    "nodes/firmware/c/README.md": "boards-in-c.md",
    "nodes/firmware/c/adaptive/README.md": "adaptive-boards.md",
}
#: A document that the text names, or a file beside the documents that it links to.
_NAMED: Final = re.compile(r"`docs/([\w-]+\.md)`")
_LINKED: Final = re.compile(r"\]\(docs/")
#: The mark of a block says to `tests/documents.py` who runs the block.
_MARK: Final = re.compile(r"^(```\w+) .*$", re.MULTILINE)


def on_config(config: "MkDocsConfig") -> None:
    """Add the pages of the API to the table of contents."""
    pages = [f"api/{package.name}.md" for package in packages()]
    config.nav = [*(config.nav or []), {"C": list(BESIDE.values())}, {"API": pages}]


def on_files(files: "Files", config: "MkDocsConfig") -> "Files":
    """Add the home page and the pages of the API."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, "index.md", content=_LINKED.sub("](", (ROOT / "README.md").read_text("utf-8"))))
    for path, name in BESIDE.items():
        files.append(File.generated(config, name, content=(ROOT / path).read_text("utf-8")))
    for package in packages():
        modules = "\n".join(f"::: {name}" for name in modules_of(package))
        files.append(File.generated(config, f"api/{package.name}.md", content=f"# {package.name}\n\n{modules}\n"))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Make links of the documents that a text names, and leave out the marks of the blocks."""
    for path, name in BESIDE.items():
        markdown = markdown.replace(f"](../{path})", f"]({name})")
    markdown = _MARK.sub(r"\1", markdown)
    return _NAMED.sub(r"[`\1`](\1)", markdown)


def packages() -> list[Path]:
    """Return the folders of the packages, the client first."""
    found = (each.parent for each in ROOT.glob("*/py.typed"))
    return [ROOT / "client" / "canskin", *sorted(found)]


def modules_of(package: Path) -> list[str]:
    """Return the names of the public modules of a package, that of the package first."""
    paths = (each.relative_to(package.parent) for each in package.rglob("*.py"))
    names = (".".join(each.with_suffix("").parts).removesuffix(".__init__") for each in paths)
    return sorted(name for name in names if "._" not in name)
