"""`docs/reference.md` from the code: verbs, topics of the fabric, objects of the nodes. `make docs` writes the page."""

import inspect
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from canskin import calibration_messages, description, messages
from canskin.messages import Topic
from canskin.question import Question
from dbc.contract import Contract
from dbc.dictionary import dictionary
from dbc.indices import BLOCK_STRIDE
from health.causes import Cause
from shell.command import VERBS, docstring, summary
from skin.layout import load_layout

PAGE: Final = Path(__file__).with_name("reference.md")
#: Layouts whose nodes have all objects together.
LAYOUTS: Final = ("default", "steps", "hand", "analogue")


def reference() -> str:
    """Return the page."""
    verbs = ((f"`skin {verb}`", summary(docstring(where))) for verb, where in VERBS.items())
    kinds = {
        id(each): each for module in (messages, description, calibration_messages) for each in vars(module).values()
    }
    topics = (
        (f"`{each.name}`", f"`{each.message.__name__}`", _about(each.message))
        for each in kinds.values()
        if isinstance(each, Topic)
    )
    questions = (
        (f"`{each.name}`", f"`{each.request.__name__}`, `{each.reply.__name__}`", _about(each.request))
        for each in kinds.values()
        if isinstance(each, Question)
    )
    return "\n".join([
        "# Reference",
        "\n`make docs` writes this page from the code. Keys of a layout: `docs/layout.md`.",
        *_table("Verbs", ("verb", "what it does"), verbs),
        "\n`--help` of a verb explains every option; `VERBS` in `shell/command.py` says where its code is.",
        *_table("Topics of the fabric", ("topic", "message", "content"), topics),
        "\nQuestions that a service answers:\n",
        *_rows(("question", "request, reply", "what is asked"), questions),
        *_table("Causes", ("code", "level", "what is seen", "what to do"), _causes()),
        "\nThe page, `skin doctor`, ROS 2, logs and metrics name what is wrong by these codes (`health/causes.py`).",
        *_table("Objects of a node", ("object", "name"), _objects()),
        f"\nObjects of each further block are {BLOCK_STRIDE:X}h higher. `skin node objects` lists types and access.",
        "Meanings: `docs/bus.md`, `docs/steps.md`.",
        "",
    ])  # fmt: skip


def _about(kind: type) -> str:
    return summary(inspect.getdoc(kind) or "")


def _causes() -> Iterator[tuple[str, ...]]:
    for each in Cause:
        yield f"`{each.code}`", each.level, each.sees, each.mend.format(subject="it")


def _objects() -> Iterator[tuple[str, str]]:
    """Yield each object of the first nodes of `LAYOUTS` once, by index."""
    contracts = [Contract.from_layout(load_layout(Path(name))) for name in LAYOUTS]
    found = {each.index: each.group or each.name for skin in contracts for each in dictionary(skin, skin.nodes[0])}
    for index, title in sorted(found.items()):
        yield f"{index:04X}h", title


def _table(heading: str, head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    return [f"\n## {heading}\n", *_rows(head, rows)]


def _rows(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    return [f"| {' | '.join(row)} |" for row in (head, ("---",) * len(head), *rows)]


if __name__ == "__main__":
    PAGE.write_text(reference(), "utf-8")
