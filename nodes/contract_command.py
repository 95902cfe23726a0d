"""``skin contract``: the contract files for analysers, masters and boards, C sources of boards, and programs."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

from canskin.errors import InputError
from dbc.choice import choose_nodes
from dbc.contract import Contract
from dbc.dictionary import REVISION
from dbc.generate import (
    DEFAULT_FOLDER,
    NODE_FOLDER,
    VECTOR_FOLDER,
    contract_files,
    drifted,
    node_files,
    write_files,
)
from dbc.program import VERSION_BYTES, Program, is_version
from nodes.firmware.export import export_files
from nodes.sending import vector_files
from shell.neighbours import tell_shared
from shell.output import check_new_path, write_file
from shell.service import say
from shell.terminal import Json, print_json
from skin.layout import Device, load_layout
from skin.limits import read_file

#: The first bytes of an ELF file, which holds a program and much else.
_ELF: Final = b"\x7fELF"


def contract(
    layout: Path | None = None,
    *,
    out: Path | None = None,
    check: Annotated[bool, Parameter(negative=())] = False,
    firmware: Annotated[bool, Parameter(negative=())] = False,
    node: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    program: Path | None = None,
    release: str | None = None,
    json: Json = False,
) -> int:
    """Write all that is needed to build the boards of a skin, or compare such files with the layout.

    A DBC for each bus and an EDS for each type of node; in the folder ``nodes`` for each node a table of its constants
    as JSON and a DCF; in the folder ``vectors`` test vectors for firmware (``docs/firmware.md``). Prints the path of
    every file; with ``--check`` the files that differ from the layout, and ends with 1 if any file differs.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    out
        Folder for the files, new or of an earlier run, or of the files to check; default of ``--check`` without a
        layout: the files of the project. With ``--program`` the new file.
    check
        Compare the files with the layout; files of nodes and test vectors where their folders are.
    firmware
        Write C99 sources in place of these files: sums, packing, object dictionary and a CANopen slave, without heap.
        ``README.md`` among them says what to do with the others.
    node
        Firmware: write the constants of these nodes, as BUS:NODE or BUS:FIRST-LAST; default: all nodes. Nodes of one
        type share one program, which takes its own constants by bus and node-ID.
    program
        Put the header that ``skin node update`` and the boards ask for before this program: what the processor runs,
        as the linker's output in binary form.
    release
        Program: its version, 1 to 8 characters, which the board tells in 100Ah.
    json
        Print one JSON list.

    Examples
    --------
    skin contract palm.toml --out palm
    skin contract palm.toml --out palm --check
    skin contract palm.toml --firmware --out palm-firmware
    skin contract palm.toml --program main.bin --release 1.1 --out palm-1.1.bin
    """
    if check + firmware + (program is not None) > 1:
        raise InputError("expected one of --check, --firmware and --program")
    if node and not firmware:
        raise InputError("expected --node with --firmware alone")
    if (program is None) != (release is None):
        raise InputError("expected --program FILE and --release VERSION together")
    skin = load_layout(layout)
    if out is None and (layout is not None or not check):
        raise InputError("expected --out: the folder of the files, or the file of the program")
    if program is not None and release is not None and out is not None:
        lines = [_write_program(program, skin.device, release, out)]
    elif check:
        lines = _drifted(Contract.from_layout(skin), out or DEFAULT_FOLDER)
    elif out is not None:
        tell_shared(skin, "contract")
        files = _files(Contract.from_layout(skin), node, firmware=firmware)
        _check_own(out, files)
        lines = [str(path) for path in write_files(files, out)]
    if json:
        print_json(lines)
    else:
        print("\n".join(lines), end="\n" if lines else "")
    return int(check and bool(lines))


def _files(skin: Contract, names: list[str] | None, *, firmware: bool) -> Mapping[str, str]:
    if not firmware:
        return contract_files(skin) | node_files(skin) | vector_files(skin)
    chosen = choose_nodes(skin, names or [], [])
    return export_files(skin, [each for each in skin.nodes if each.node_id in chosen.get(each.bus, ())])


def _check_own(folder: Path, files: Mapping[str, str]) -> None:
    """Check that a folder has nothing that would be written over, unless an earlier run has written there."""
    there = [name for name in files if (folder / name).exists()]
    if there and there[0] != next(iter(files)):
        raise InputError(f"{folder}: has a {there[0]} that 'skin contract' did not write: expected a new folder")


def _drifted(skin: Contract, folder: Path) -> list[str]:
    wanted = contract_files(skin)
    for inner, files_of in ((NODE_FOLDER, node_files), (VECTOR_FOLDER, vector_files)):
        wanted |= files_of(skin) if (folder / inner).is_dir() else {}
    lines = drifted(wanted, folder)
    if lines:
        say("contract", f"{len(lines)} files have drifted; write them anew with 'skin contract' and --out {folder}")
    return lines


def _write_program(binary: Path, device: Device, release: str, out: Path) -> str:
    """Write a program with its header."""
    if not is_version(release):
        raise InputError(f"--release: expected 1 to {VERSION_BYTES} printable characters of ASCII, got '{release}'")
    data = read_file(binary, InputError, "the program")
    if not data:
        raise InputError(f"{binary}: expected a compiled program, got an empty file")
    if data.startswith(_ELF):
        raise InputError(f"{binary}: expected what the processor runs, got an ELF file: objcopy -O binary makes it")
    check_new_path(out, "program")
    program = Program(device.vendor_id, device.product_code, REVISION, release, data)
    write_file(out, program.image)
    return f"{out}: version {release}, {len(program.image)} bytes, identification (1F56h) {program.identification:08X}h"
