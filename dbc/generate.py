"""The contract files of a skin: content, writing, and comparison with a folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from canskin.errors import InputError, reasoned
from dbc.board import board, board_text
from dbc.contract import Contract
from dbc.database import database
from dbc.eds import dcfs, eds, node_name, node_types
from shell.output import write_file

#: The files of the default skin that come with the project.
DEFAULT_FOLDER: Final = Path(__file__).parent / "files" / "default"
SUFFIXES: Final = (".dbc", ".eds")
#: Folder of the files of single nodes, and the suffixes of its files.
NODE_FOLDER: Final = "nodes"
NODE_SUFFIXES: Final = (".json", ".dcf")
#: Folder of the test vectors for firmware.
VECTOR_FOLDER: Final = "vectors"


def contract_files(contract: Contract) -> dict[str, str]:
    """Return the text of every contract file by its name: a DBC per bus, an EDS per type of node."""
    buses = {f"{bus.name}.dbc": database(contract, number) for number, bus in enumerate(contract.layout.bus)}
    return buses | {kind.file: eds(contract, kind) for kind in node_types(contract)}


def node_files(contract: Contract) -> dict[str, str]:
    """Return the text of the files of single nodes by their path: a table of constants and a DCF for each."""
    files: dict[str, str] = {}
    for kind in node_types(contract):
        for node, dcf in dcfs(contract, kind):
            path = f"{NODE_FOLDER}/{node_name(contract, node)}"
            files |= {f"{path}.json": board_text(board(contract, node)), f"{path}.dcf": dcf}
    return files


def write_files(files: Mapping[str, str], folder: Path) -> list[Path]:
    """Write texts by path inside `folder`, and return their paths; raise InputError if one cannot be written."""
    written = []
    with reasoned(InputError, f"{folder}: cannot write the files"):
        for name, text in files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_file(path, text.encode("ascii"))
            written.append(path)
    return written


def drifted(wanted: Mapping[str, str], folder: Path) -> list[str]:
    """Return one line for each file of `folder` that differs from `wanted`, texts by path inside the folder."""
    with reasoned(InputError, f"{folder}: cannot read the contract files"):
        there = {path.name: path.read_bytes() for path in folder.iterdir() if path.suffix in SUFFIXES}
        for inner in (NODE_FOLDER, VECTOR_FOLDER):
            paths = [path for path in folder.glob(f"{inner}/*") if path.suffix in NODE_SUFFIXES]
            there |= {f"{inner}/{path.name}": path.read_bytes() for path in paths}
    lines = []
    for name in sorted({*wanted, *there}):
        if name not in there:
            lines.append(f"{folder / name} is missing")
        elif name not in wanted:
            lines.append(f"{folder / name} does not belong to this layout")
        elif there[name] != wanted[name].encode("ascii"):
            lines.append(f"{folder / name} differs from what the layout makes of it")
    return lines
