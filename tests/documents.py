"""The code in the documents: its blocks, which test runs each, or why none does.

The line that opens a block has its language and, where ``tests/test_documents.py`` does not run the block, a mark: a
reason of `REASONS`, or the test that runs the block. Tests of Python blocks take them with `block`.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parents[1]
#: Documents, as paths in the tree.
DOCUMENTS: Final = sorted(
    path.relative_to(ROOT).as_posix()
    for pattern in ("README.md", "docs/*.md", "client/**/README.md", "nodes/**/README.md", "deploy/**/*.md")
    for path in ROOT.glob(pattern)
)
#: Why no test runs a block of commands. The commands are parsed all the same.
REASONS: Final = (
    *("needs hardware", "needs a running skin", "needs data", "needs a network", "needs root", "needs other programs"),
    *("starts services", "takes minutes"),
)
_BLOCK: Final = re.compile(r"^```(\w+) ?(.*)\n((?:.*\n)*?)```$", re.MULTILINE)


@dataclass(frozen=True)
class Block:
    """A block of code.

    Attributes
    ----------
    line : int
        Line of the document, from 1, that opens the block.
    mark : str
        A reason of `REASONS` or the test that runs the block; empty: ``tests/test_documents.py`` runs the block.
    """

    document: str
    line: int
    language: str
    mark: str
    code: str

    def __str__(self) -> str:
        return f"{self.document}:{self.line}"


def blocks(document: str, language: str) -> list[Block]:
    """Return the blocks of a document in a language."""
    text = (ROOT / document).read_text("utf-8")
    found = (Block(document, text.count("\n", 0, each.start()) + 1, *each.groups()) for each in _BLOCK.finditer(text))
    return [each for each in found if each.language == language]


def block(document: str, word: str) -> str:
    """Return the Python block of a document that has a word; the only one."""
    (found,) = (each.code for each in blocks(document, "python") if word in each.code)
    return found
