"""The constants of boards as C: ``board.h`` and ``board.c``, made from `dbc.board` and `dbc.dictionary`.

One pair of files holds one board, for its firmware, or all boards of a skin, for the library that runs them together.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canskin.errors import InputError
from dbc import indices as od
from dbc.adaptive_filter import HORIZON, SWITCHING, Models, make_models
from dbc.averaging import averaging_models
from dbc.board import Board, board
from dbc.canopen import LSS_BIT_RATES_HZ
from dbc.configuration import configuration, setting_of
from dbc.contract import Contract, NodeContract, sum_frame_bits
from dbc.dictionary import ERRORS_KEPT, HEARTBEATS_WATCHED, dictionary
from dbc.frame_bits import frame_time_ns
from dbc.objects import Object
from nodes.firmware.c_text import WRITTEN, array, braced, defined, header, real

#: Flags of `skin_object` (``skin_board.h``).
WRITABLE, MAPPABLE, COVERED, TEXT = 1, 2, 4, 8
#: Place of objects that the firmware computes and that have no stored value.
COMPUTED: Final = 0xFFFF
_COMPUTED: Final = (od.ERROR_REGISTER, od.ERROR_FIELD, od.STORE, od.RESTORE, od.SIGNATURE, od.HEALTH, od.NODE_NOISE)
#: Arrays whose entries are computed, but not their sub-index 0.
_COMPUTED_ENTRIES: Final = (od.STORE, od.RESTORE, od.HEALTH, od.COARSE, od.FINE)


@dataclass(frozen=True)
class ObjectTable:
    """The dictionary of a board as the firmware holds it.

    Attributes
    ----------
    entries : tuple of (int, int, int, int, int)
        Index, sub-index, flags, place of the value, bytes of the value; ascending.
    values : bytes
        Initial values, each little endian: first those of objects that can be written, communication profile before
        manufacturer, then the others.
    objects : tuple of Object
        In the order of `entries`.
    communication_bytes, writable_bytes : int
        Bytes of `values` that belong to writable objects below 2000h, and to all writable objects.
    """

    entries: tuple[tuple[int, int, int, int, int], ...]
    values: bytes
    objects: tuple[Object, ...]
    communication_bytes: int
    writable_bytes: int


@dataclass(frozen=True)
class Build:
    """What the C sources of one board are made from.

    `is_adaptive` tells whether the board sends sums when they carry news, `held` is the number of its taxels,
    `frame_ns` the longest time of one of its frames. `frame_bits` are those of a coarse and a fine frame of an adaptive
    board.
    """

    node: NodeContract
    board: Board
    objects: ObjectTable
    is_adaptive: bool
    held: int
    frame_ns: int
    frame_bits: tuple[int, int]


def builds(contract: Contract, nodes: Sequence[NodeContract]) -> list[Build]:
    """Return what the C sources of `nodes` are made from; raise InputError if they make their sums in hardware."""
    if contract.layout.taxels.is_analogue:
        raise InputError('the C firmware adds taxels that are digital: expected taxels.frontend = "digital"')
    is_adaptive = contract.layout.sending == "adaptive"
    of_bus = {bus: _frame_sizes(contract, bus) for bus in {node.bus for node in nodes}}
    held = [int(contract.phi.held[node.block : node.block + node.blocks].sum()) for node in nodes]
    return [
        Build(node, board(contract, node), _object_table(contract, node), is_adaptive, taxels, *of_bus[node.bus])
        for node, taxels in zip(nodes, held, strict=True)
    ]


def _frame_sizes(contract: Contract, bus: int) -> tuple[int, tuple[int, int]]:
    """Return `frame_ns` and `frame_bits` of `Build` for the boards of a bus."""
    line = contract.layout.bus[bus]
    if contract.layout.sending != "adaptive":
        return int(frame_time_ns(contract.cycle(bus), line.bitrate, line.data_bitrate, "worst").max()), (0, 0)
    coarse, fine = (sum_frame_bits(line, contract.layout.groups, is_fine=is_fine) for is_fine in (False, True))
    return round(fine * 1e9 / line.bitrate), (coarse, fine)


def _object_table(contract: Contract, node: NodeContract) -> ObjectTable:
    covered = {(each.index, each.subindex) for each in configuration(contract, node)}
    objects = dictionary(contract, node)
    stored = [each for each in objects if not _is_computed(each)]
    communication = [each for each in stored if each.access == "rw" and each.index < od.MANUFACTURER]
    settings = [each for each in stored if each.access == "rw" and each.index >= od.MANUFACTURER]
    values, places = bytearray(), {}
    ends = []
    for part in (communication, settings, [each for each in stored if each.access != "rw"]):
        for each in part:
            places[each.index, each.subindex] = len(values)
            values += setting_of(each).data
        ends.append(len(values))
    entries = tuple(
        (
            each.index,
            each.subindex or 0,
            WRITABLE * (each.access == "rw")
            | MAPPABLE * each.pdo
            | COVERED * ((each.index, each.subindex or 0) in covered)
            | TEXT * (each.data_type == od.VISIBLE_STRING),
            places.get((each.index, each.subindex), COMPUTED),
            len(setting_of(each).data),
        )
        for each in objects
    )
    return ObjectTable(entries, bytes(values), tuple(objects), ends[0], ends[1])


def _is_computed(each: Object) -> bool:
    if each.index in _COMPUTED_ENTRIES or _is_measured(each.index):
        return each.subindex != 0
    return each.index in _COMPUTED


def _is_measured(index: int) -> bool:
    return index >= od.MANUFACTURER and od.split_block(index)[1] in (od.SUMS, od.COUNTS)


def board_header(contract: Contract, boards: Sequence[Build]) -> str:
    """Return ``board.h``: sizes that hold every one of `boards`."""
    is_adaptive = boards[0].is_adaptive
    sizes: dict[str, tuple[object, str]] = {
        "SKIN_BOARDS": (len(boards), "boards of board.c"),
        "SKIN_BLOCKS": (max(each.node.blocks for each in boards), "blocks of a board"),
        "SKIN_BLOCK_SIZE": (contract.phi.block_size, "taxels of a block"),
        "SKIN_SUMS": (max(1, *(each.node.sums for each in boards)), "sums of a board"),
        "SKIN_TPDOS": (max(1, *(_tpdos(each.node) for each in boards)), "TPDO communication records of a board"),
        "SKIN_PDO_BYTES": (max(each.node.pdo_bytes for each in boards), "longest payload of a PDO"),
        "SKIN_ADAPTIVE": (int(is_adaptive), "whether sums are sent when they carry news"),
        "SKIN_SAMPLES": (
            1 if is_adaptive else contract.layout.samples_per_sync,
            "samples of each taxel in a cycle; more than 1 are averaged",
        ),
        "SKIN_WATCHED": (HEARTBEATS_WATCHED, "entries of 1016h"),
        "SKIN_ERRORS_KEPT": (ERRORS_KEPT, "entries of 1003h"),
        "SKIN_WRITABLE_BYTES": (max(each.objects.writable_bytes for each in boards), "values that SDO can write"),
    }
    rates = {each.board.bitrate for each in boards}
    timings = sum(1 << index for index, rate in enumerate(LSS_BIT_RATES_HZ) if rate in rates)
    sizes["SKIN_BIT_TIMINGS"] = timings, "bit n: bit timing n of LSS (CiA 305) is that of a board"
    lines = defined(sizes | _models(make_models(HORIZON) if is_adaptive else averaging_models(), HORIZON * is_adaptive))
    if len(boards) == 1:
        table = boards[0].board
        lines += [
            f"#define SKIN_NODE_ID {table.node_id}",
            f"#define SKIN_BITRATE {table.bitrate}",
            *([f"#define SKIN_DATA_BITRATE {table.data_bitrate}"] if table.data_bitrate else []),
        ]
    parts = ['#include "skin_board.h"', "", *lines, "", "extern const skin_board skin_boards[SKIN_BOARDS];"]
    return header("BOARD_H", f"Sizes of {_names(boards)}.", parts)


def _models(models: Models, horizon: float) -> dict[str, tuple[object, str]]:
    """Return the numbers of the models of ``skin_models.c``."""
    count = len(models.gain)
    rows = (braced(map(real, each)) for each in zip(*models, strict=True))
    return {
        "SKIN_MODELS": (count, "models that run side by side"),
        "SKIN_AVERAGE_COUNT": (int(np.count_nonzero(models.slope_gain == 0)), "the first of them: averages"),
        "SKIN_MODEL_ROWS": (braced(rows, per_line=1), "each as skin_model"),
        "SKIN_CHANGE": (real(SWITCHING / (count - 1)), "chance of a change to a model in one sample"),
        "SKIN_STAY": (real(1.0 - SWITCHING), "chance of no change"),
        "SKIN_HORIZON": (real(horizon), "samples that a forecast looks ahead"),
    }


def board_source(boards: Sequence[Build]) -> str:
    """Return ``board.c``: the constants of `boards`, in their order."""
    shared: dict[tuple[tuple[int, int, int, int, int], ...], str] = {}
    parts, rows = [], []
    for number, each in enumerate(boards):
        entries = each.objects.entries
        if entries not in shared:
            shared[entries] = f"objects_{len(shared)}"
            parts.append(_objects(shared[entries], entries))
        parts.append(_arrays(each, number))
        rows.append(_board(each, number, shared[entries]))
    return "\n".join(
        [
            f"/* Constants of {_names(boards)}. {WRITTEN} */",
            '#include "board.h"',
            "",
            *parts,
            "const skin_board skin_boards[SKIN_BOARDS] = {",
            *rows,
            "};",
            "",
        ]
    )


def _objects(name: str, entries: Iterable[tuple[int, int, int, int, int]]) -> str:
    rows = [
        f"    {{0x{index:04X}, {subindex}, 0x{flags:02X}, {at}, {length}}},"
        for index, subindex, flags, at, length in entries
    ]
    return "\n".join(
        ["/* index, sub-index, flags, place, bytes */", f"static const skin_object {name}[] = {{", *rows, "};", ""]
    )


def _arrays(build: Build, number: int) -> str:
    blocks = build.board.blocks
    return "\n".join(
        [
            f"/* {build.board.bus}:{build.board.node_id} */",
            *array(
                "static const uint16_t", f"first_sum_{number}", [*(each.first_sum for each in blocks), build.node.sums]
            ),
            *array("static const uint8_t", f"rows_{number}", [row for each in blocks for row in each.rows]),
            *array("static const uint16_t", f"taxels_{number}", [taxel for each in blocks for taxel in each.taxels]),
            *array("static const uint8_t", f"values_{number}", build.objects.values),
            "",
        ]
    )


def _board(build: Build, number: int, objects_name: str) -> str:
    node, objects = build.node, build.objects
    packing = node.packing
    fields: dict[str, object] = {
        "node_id": build.board.node_id,
        "blocks": node.blocks,
        "block_size": len(build.board.blocks[0].taxels),
        "held": build.held,
        "count_max": build.board.count_max,
        "packing": f"{{{packing.bits}, {packing.scale.bit_length() - 1}, {packing.offset}}}",
        "first_sum": f"first_sum_{number}",
        "rows": f"rows_{number}",
        "taxels": f"taxels_{number}",
        "tpdos": _tpdos(node),
        "pdo_bytes": node.pdo_bytes,
        "frame_flags": node.flags,
        "frame_ns": build.frame_ns,
        "frame_bits": "{" + ", ".join(map(str, build.frame_bits)) + "}",
        "objects": objects_name,
        "object_count": len(objects.entries),
        "values": f"values_{number}",
        "communication_bytes": objects.communication_bytes,
        "writable_bytes": objects.writable_bytes,
    }
    return "    {" + ", ".join(f".{name} = {value}" for name, value in fields.items()) + "},"


def _tpdos(node: NodeContract) -> int:
    return len(node.tpdos) + len(node.adaptive_tpdos)


def _names(boards: Sequence[Build]) -> str:
    """Return the boards as text for a comment."""
    first = boards[0].board
    more = f" and {len(boards) - 1} more boards" if len(boards) > 1 else ""
    return f"{first.bus}:{first.node_id}{more} of the skin {first.skin}"
