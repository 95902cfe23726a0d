"""One HTML file with every table and plot of an evaluation: nothing to fetch, nothing to run."""

import base64
import html
import io
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from evaluation.result import Options, Picture, Result, Row, write_text

_STYLE: Final = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 80rem; margin: 2rem auto; padding: 0 1rem; color: #1a1a1a; }
h2 { margin-top: 3rem; border-top: 1px solid #ddd; padding-top: 1rem; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .15rem .7rem; text-align: right; border-bottom: 1px solid #eee; }
th { position: sticky; top: 0; background: #fff; }
td.text, th.text { text-align: left; min-width: 6rem; }
details { overflow-x: auto; }
figure { margin: 1.5rem 0; }
figure img { max-width: 100%; }
figcaption, li { max-width: 55rem; }
"""


def write_report(results: Mapping[str, Result], options: Options, folder: Path) -> Path:
    """Write ``report.html`` and return its path."""
    path = folder / "report.html"
    body = "".join(_section(name, found) for name, found in results.items())
    contents = "".join(f'<li><a href="#{name}">{html.escape(found.title)}</a></li>' for name, found in results.items())
    text = (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>canskin, evaluated</title>'
        f"<style>{_STYLE}</style></head><body><h1>canskin beside the paper</h1>"
        f"<p>{html.escape(_made(options))}</p><ol>{contents}</ol>{body}</body></html>\n"
    )
    write_text(path, text)
    return path


def _made(options: Options) -> str:
    shapes = "meshes" if options.meshes else "the shapes that ship with the project, not meshes"
    extent = "A quick look: fewer steps and draws than the figures need. " if options.quick else ""
    return (
        f"{extent}Made with canskin {version('canskin')}, Python {platform.python_version()}, {platform.machine()}; "
        f"objects: {shapes}; seed {options.seed}."
    )


def _section(name: str, found: Result) -> str:
    note = f"<p>{html.escape(found.note)}</p>" if found.note else ""
    pictures = "".join(_figure(picture) for picture in found.pictures)
    return f'<h2 id="{name}">{html.escape(found.title)}</h2>{note}{pictures}{_table(found.rows)}'


def _figure(picture: Picture) -> str:
    data = io.BytesIO()
    picture.draw().savefig(data, format="png", dpi=110)
    encoded = base64.b64encode(data.getvalue()).decode()
    caption = html.escape(picture.caption)
    source = f"data:image/png;base64,{encoded}"
    return f'<figure><img alt="{caption}" src="{source}"><figcaption>{caption}</figcaption></figure>'


def _table(rows: list[Row]) -> str:
    if not rows:
        return ""
    heads = "".join(f"<th{_kind(value)}>{html.escape(key)}</th>" for key, value in rows[0].items())
    lines = "".join("<tr>" + "".join(map(_cell, row.values())) + "</tr>" for row in rows)
    return f"<details open><summary>{len(rows)} rows</summary><table><tr>{heads}</tr>{lines}</table></details>"


def _cell(value: Any) -> str:
    shown = "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
    return f"<td{_kind(value)}>{html.escape(shown)}</td>"


def _kind(value: Any) -> str:
    return ' class="text"' if isinstance(value, str) else ""
