"""``skin dbc``: the contract files for bus analysers and CANopen masters."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from dbc.contract import Contract
from dbc.generate import DEFAULT_FOLDER, drifted, write_files
from skin.errors import InputError
from skin.layout import load_layout
from skin.service import say
from skin.terminal import Json, print_json


def dbc(
    layout: Path | None = None,
    *,
    out: Path | None = None,
    check: Annotated[bool, Parameter(negative=())] = False,
    json: Json = False,
) -> int:
    """Write the contract of a skin as files: a DBC per bus and an EDS per type of node.

    Prints the path of every file. With ``--check``, prints the files that differ from the layout, and ends with 1 if
    any file differs.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    out
        Folder for the files; with ``--check``, the folder to compare. Default of ``--check``: the files of the project.
    check
        Write nothing; compare the files with the layout.
    json
        Print one JSON list.

    Examples
    --------
    skin dbc palm.toml --out palm-files
    skin dbc --check
    """
    if out is None and (layout is not None or not check):
        raise InputError("expected --out FOLDER: the folder of the contract files")
    contract = Contract.from_layout(load_layout(layout))
    folder = out or DEFAULT_FOLDER
    lines = drifted(contract, folder) if check else [str(path) for path in write_files(contract, folder)]
    if json:
        print_json(lines)
    else:
        print("\n".join(lines), end="\n" if lines else "")
    if check and lines:
        say("dbc", f"{len(lines)} files have drifted; write them anew with 'skin dbc' and --out {folder}")
    return int(check and bool(lines))
