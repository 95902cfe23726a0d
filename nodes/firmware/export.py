"""The texts of the firmware: C sources that every board shares, the constants of each board, and ``README.md``."""

from collections.abc import Sequence
from importlib.resources import files
from string import Template
from typing import Final

from dbc.contract import Contract, NodeContract
from dbc.eds import node_name
from dbc.slots import SLOT_HEAD
from nodes.firmware.contract_header import contract_header
from nodes.firmware.object_dictionary import od_header, od_source
from nodes.firmware.stepped_tables import stepped_header, stepped_source
from nodes.firmware.tables import Build, board_header, board_source, builds, by_type

#: Bytes of a `skin_board` on a processor of 32 bits.
_ENTRY_BYTES: Final = 12
_SOURCES: Final = files("nodes.firmware").joinpath("c")


def sources(boards: Sequence[Build], *folders: str) -> dict[str, str]:
    """Return by their path the C sources and headers that every one of `boards` needs, and those of more folders."""
    found: dict[str, str] = {}
    for folder in ("", "steps", *folders) if boards[0].in_steps else ("", *folders):
        for each in sorted(_SOURCES.joinpath(folder).iterdir(), key=lambda each: each.name):
            if each.name.endswith((".c", ".h")):
                found[f"{folder}/{each.name}" if folder else each.name] = each.read_text(encoding="ascii")
    return found


def constants(contract: Contract, boards: Sequence[Build]) -> dict[str, str]:
    """Return the C texts of the constants of `boards`, by file."""
    found = {
        "contract.h": contract_header(),
        "board.h": board_header(contract, boards),
        "board.c": board_source(boards),
    }
    if boards[0].in_steps:
        found |= {"stepped.h": stepped_header(contract), "stepped.c": stepped_source(contract)}
    return found


def export_files(contract: Contract, nodes: Sequence[NodeContract]) -> dict[str, str]:
    """Return the text of every file of ``skin contract --firmware`` by its path."""
    boards = builds(contract, nodes)
    found = {f"src/{path}": text for path, text in sources(boards, "slave", "canopennode").items()}
    for folder in ("ports", "ports/virt"):
        inside = (each for each in _SOURCES.joinpath(folder).iterdir() if each.is_file())
        found |= {f"{folder}/{each.name}": each.read_text(encoding="ascii") for each in inside}
    for folder, image in images(contract, boards).items():
        found |= {f"boards/{folder}/{name}": text for name, text in constants(contract, image).items()}
        found |= {f"boards/{folder}/OD.h": od_header(image), f"boards/{folder}/OD.c": od_source(image)}
    return found | {"README.md": _readme(contract, boards)}


def _readme(contract: Contract, boards: Sequence[Build]) -> str:
    """Return ``README.md`` for the engineer who builds the firmware, with the figures of the first of `boards`."""
    node, board, objects = boards[0].node, boards[0].board, boards[0].objects
    folder = _SOURCES.joinpath("steps") if boards[0].in_steps else _SOURCES
    texts = (each.joinpath("README.md").read_text(encoding="utf-8") for each in (folder, _SOURCES.joinpath("slave")))
    return Template("\n".join(texts)).substitute(
        skin=board.skin,
        blocks=node.blocks,
        block_size=contract.phi.block_size,
        sums=node.sums,
        board=next(iter(images(contract, boards))),
        table_bytes=_ENTRY_BYTES + objects.own_first + objects.own_middle,
        period_us=board.sync_period_us,
        window_us=board.sync_window_us,
        samples=board.samples_per_sync,
        slot_bytes=SLOT_HEAD + objects.writable_bytes,
    )


def images(contract: Contract, boards: Sequence[Build]) -> dict[str, list[Build]]:
    """Return the boards of each program by the name of its folder: one program for all boards of a type."""
    groups = by_type(boards)
    if len(groups) == 1 and len(boards) > 1:
        return {"all": groups[0]}
    several = {f"type-{number}": group for number, group in enumerate(groups, 1)}
    return {node_name(contract, group[0].node) if len(group) == 1 else name: group for name, group in several.items()}
