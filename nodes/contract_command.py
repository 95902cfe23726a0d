"""``skin dbc``, ``skin contract`` and ``skin dbc-check``: the contract files for analysers, masters and boards."""

from collections.abc import Sequence
from pathlib import Path

from canskin.errors import InputError
from dbc.contract import Contract
from dbc.generate import (
    DEFAULT_FOLDER,
    NODE_FOLDER,
    VECTOR_FOLDER,
    contract_files,
    drifted,
    node_files,
    write_files,
)
from nodes.ways import vector_files
from shell.service import say
from shell.terminal import Json, print_json
from skin.layout import load_layout


def dbc(layout: Path | None = None, *, out: Path, json: Json = False) -> None:
    """Write the contract of a skin as files: a DBC per bus and an EDS per type of node.

    Prints the path of every file. ``skin dbc-check`` compares the files with a layout.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    out
        Folder for the files.
    json
        Print one JSON list.

    Examples
    --------
    skin dbc --out contract
    skin dbc palm.toml --out palm-files
    """
    contract = Contract.from_layout(load_layout(layout))
    _show([str(path) for path in write_files(contract_files(contract), out)], as_json=json)


def contract(layout: Path | None = None, *, out: Path, json: Json = False) -> None:
    """Write all that is needed to build the boards of a skin.

    Beside the files of ``skin dbc``: in the folder ``nodes`` for each node a table of its constants as JSON and a DCF,
    in the folder ``vectors`` test vectors for firmware (``docs/firmware.md``). Prints the path of every file.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    out
        Folder for the files.
    json
        Print one JSON list.

    Examples
    --------
    skin contract --out contract
    skin contract palm.toml --out palm-files
    """
    skin = Contract.from_layout(load_layout(layout))
    _show(
        [str(path) for path in write_files(contract_files(skin) | node_files(skin) | vector_files(skin), out)],
        as_json=json,
    )


def dbc_check(layout: Path | None = None, *, files: Path | None = None, json: Json = False) -> int:
    """Compare contract files with a layout.

    Prints the files that differ from the layout, and ends with 1 if any file differs.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    files
        Folder of the files. Default, for the default skin alone: the files of the project.
    json
        Print one JSON list.

    Examples
    --------
    skin dbc-check
    skin dbc-check palm.toml --files palm-files
    """
    if files is None and layout is not None:
        raise InputError("expected --files FOLDER: the folder of the contract files")
    folder = files or DEFAULT_FOLDER
    skin = Contract.from_layout(load_layout(layout))
    wanted = contract_files(skin)
    # Files of nodes and test vectors are compared where their folders exist.
    for inner, files_of in ((NODE_FOLDER, node_files), (VECTOR_FOLDER, vector_files)):
        wanted |= files_of(skin) if (folder / inner).is_dir() else {}
    lines = drifted(wanted, folder)
    _show(lines, as_json=json)
    if lines:
        say(
            "dbc-check",
            f"{len(lines)} files have drifted; write them anew with 'skin dbc' or 'skin contract' and --out {folder}",
        )
    return int(bool(lines))


def _show(lines: Sequence[str], *, as_json: bool) -> None:
    if as_json:
        print_json(lines)
    else:
        print("\n".join(lines), end="\n" if lines else "")
