"""Help texts of verbs, read from the source: importing every folder for a list of verbs would take seconds."""

import ast
import inspect
import textwrap
from importlib.util import find_spec
from pathlib import Path


def docstring(where: str) -> str:
    """Return the docstring of the function at ``module:function``, empty without docstring."""
    module, _, name = where.partition(":")
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        return ""
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    found = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == name]
    return ast.get_docstring(found[0]) or "" if found else ""


def summary(text: str) -> str:
    """Return the first line of a docstring."""
    return text.partition("\n")[0]


def examples(text: str) -> str:
    """Return the Examples section of a NumPy docstring as Markdown, one line per example; empty without section."""
    _, heading, section = inspect.cleandoc(text).partition("Examples\n--------\n")
    lines = textwrap.dedent(section).strip().splitlines()
    # No code block: empty lines would be shown around the block.
    return "\\\n".join(["Examples:", *(f"`{line}`" for line in lines if line)]) if heading else ""
