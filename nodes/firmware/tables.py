"""The constants of boards as C: ``board.h`` and ``board.c``, made from `dbc.board` and `dbc.dictionary`.

One pair of files holds one board or all boards of a type, for their firmware, or all boards of a skin, for the library
that runs them together. What boards of a type share is there once.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from dbc import indices as od
from dbc.averaging import averaging_models
from dbc.board import Board, board
from dbc.canopen import LSS_BIT_RATES_HZ
from dbc.configuration import calibration, configuration, setting_of
from dbc.contract import Contract, NodeContract
from dbc.dictionary import ERRORS_KEPT, HEARTBEATS_WATCHED, WINDOWS_MET, dictionary
from dbc.objects import Object
from dbc.patch_filter import HORIZON, SWITCHING, Models, make_models
from nodes.firmware.c_text import WRITTEN, array, braced, defined, header, real

#: Flags of `skin_object` (``skin_board.h``).
WRITABLE, MAPPABLE, COVERED, CALIBRATING = 1, 2, 4, 8
#: Place of objects that the firmware computes and that have no stored value.
COMPUTED: Final = 0xFFFF
_COMPUTED: Final = (
    od.ERROR_REGISTER,
    od.ERROR_FIELD,
    od.STORE,
    od.RESTORE,
    od.SIGNATURE,
    od.CALIBRATION_SIGNATURE,
    od.HEALTH,
    od.SYNC_COUNTER,
    od.NODE_NOISE,
)
#: Arrays whose entries are computed, but not their sub-index 0.
_COMPUTED_ENTRIES: Final = (od.STORE, od.RESTORE, od.HEALTH, od.WORDS)


#: The objects of a board, each with the bytes of its value.
_Dictionary = Sequence[tuple[Object, bytes]]


@dataclass(frozen=True)
class ObjectTable:
    """The dictionary of the boards of a type as the firmware holds it.

    Attributes
    ----------
    entries : tuple of (int, int, int, int, int)
        Index, sub-index, flags, place of the value, bytes of the value; ascending.
    objects : tuple of Object
        In the order of `entries`; values are those of the first board.
    differing : frozenset of (int, int)
        Index and sub-index of the objects whose values differ between the boards.
    communication_bytes, writable_bytes : int
        Bytes of the values of writable objects below 2000h, and of all writable objects.
    own_first, own_from, own_middle : int
        Bytes of each board's own values at the begin of all; where its other own values begin, and their bytes: the end
        of the writable ones and the begin of the others. Own are `differing`, and the rows of the sums.
    """

    entries: tuple[tuple[int, int, int, int, int], ...]
    objects: tuple[Object, ...]
    differing: frozenset[tuple[int, int]]
    communication_bytes: int
    writable_bytes: int
    own_first: int
    own_from: int
    own_middle: int


@dataclass(frozen=True)
class Build:
    """What the C sources of one board are made from.

    `objects` is the same for all boards of a type. `values` are the defaults of this board, each little endian: those
    of objects that can be written, communication profile before manufacturer, then the others; the board's own are the
    first of each part. `in_steps` tells whether the board sends steps, `held` is the number of its taxels,
    `frame_ns` the longest time of one of its frames.
    """

    node: NodeContract
    board: Board
    objects: ObjectTable
    values: bytes
    in_steps: bool
    held: int
    frame_ns: int

    @property
    def own(self) -> bytes:
        """The values that are not shared with other boards of the type."""
        table = self.objects
        return self.values[: table.own_first] + self.values[table.own_from : table.own_from + table.own_middle]

    @property
    def shared(self) -> bytes:
        """The other values."""
        table = self.objects
        return self.values[table.own_first : table.own_from] + self.values[table.own_from + table.own_middle :]


def builds(contract: Contract, nodes: Sequence[NodeContract]) -> list[Build]:
    """Return what the C sources of `nodes` are made from."""
    in_steps = contract.layout.sending == "steps"
    frame_ns = {bus: contract.longest_ns(bus) for bus in {node.bus for node in nodes}}
    boards = [board(contract, node) for node in nodes]
    dictionaries = [
        [(each, setting_of(each).data) for each in dictionary(contract, node)]  # each with the bytes of its value
        for node in nodes
    ]
    types: dict[object, list[int]] = {}
    for number, node in enumerate(nodes):
        kind = _type_of(boards[number], node, dictionaries[number], frame_ns[node.bus])
        types.setdefault(kind, []).append(number)
    tables: dict[int, ObjectTable] = {}
    for numbers in types.values():
        table = _object_table(contract, nodes[numbers[0]], [dictionaries[each] for each in numbers])
        tables |= dict.fromkeys(numbers, table)
    return [
        Build(
            node,
            boards[number],
            tables[number],
            _values(tables[number], dictionaries[number]),
            in_steps,
            int(contract.phi.held[node.block : node.block + node.blocks].sum()),
            frame_ns[node.bus],
        )
        for number, node in enumerate(nodes)
    ]


def by_type(boards: Sequence[Build]) -> list[list[Build]]:
    """Return the boards of each type, in their order."""
    found: dict[int, list[Build]] = {}
    for each in boards:
        found.setdefault(id(each.objects), []).append(each)
    return list(found.values())


def _type_of(table: Board, node: NodeContract, objects: _Dictionary, frame_ns: int) -> object:
    """Return what boards of one type have in common: all but values."""
    shape = tuple(
        (each.index, each.subindex, each.access, each.pdo, each.data_type, len(data)) for each, data in objects
    )
    first_sums = tuple(each.first_sum for each in table.blocks)
    return shape, first_sums, node.packing, node.flags, frame_ns, table.bitrate, table.data_bitrate


def _object_table(contract: Contract, node: NodeContract, boards: Sequence[_Dictionary]) -> ObjectTable:
    """Return the table of the objects of boards of one type, the first of them `node`."""
    covered = {(each.index, each.subindex) for each in configuration(contract, node)}
    calibrating = {(each.index, each.subindex) for each in calibration(contract, node)}
    differing = frozenset(
        (each.index, each.subindex or 0)
        for (each, data), *others in zip(*boards, strict=True)
        if any(other != data for _, other in others)
    )

    def rank(each: Object) -> int:
        """Rank the rows first, in the order of the sums; then what is the board's own besides; then what is shared.

        Settings stand the other way round, so that their own values are next to own constants.
        """
        return 0 if _is_row(each) else 1 if (each.index, each.subindex or 0) in differing else 2

    kept = [(each, len(data)) for each, data in boards[0] if not _is_computed(each)]
    stored = sorted(kept, key=lambda pair: rank(pair[0]))
    communication = [pair for pair in stored if pair[0].access == "rw" and pair[0].index < od.MANUFACTURER]
    settings = [pair for pair in reversed(stored) if pair[0].access == "rw" and pair[0].index >= od.MANUFACTURER]
    constant = [pair for pair in stored if pair[0].access != "rw"]
    places: dict[tuple[int, int | None], int] = {}
    ends = [0]
    for part in (communication, settings, constant):
        end = ends[-1]
        for each, length in part:
            places[each.index, each.subindex] = end
            end += length
        ends.append(end)
    entries = tuple(
        (
            each.index,
            each.subindex or 0,
            WRITABLE * (each.access == "rw")
            | MAPPABLE * each.pdo
            | COVERED * ((each.index, each.subindex or 0) in covered)
            | CALIBRATING * ((each.index, each.subindex or 0) in calibrating),
            places.get((each.index, each.subindex), COMPUTED),
            len(data),
        )
        for each, data in boards[0]
    )
    first, last, rest = (
        sum(length for each, length in part if rank(each) < 2) for part in (communication, settings, constant)
    )
    objects = tuple(each for each, _ in boards[0])
    return ObjectTable(entries, objects, differing, ends[1], ends[2], first, ends[2] - last, last + rest)


def _values(table: ObjectTable, objects: _Dictionary) -> bytes:
    """Return the values of the objects of a board, each at its place."""
    placed = [(at, data) for (*_, at, _), (_, data) in zip(table.entries, objects, strict=True) if at != COMPUTED]
    return b"".join(data for _, data in sorted(placed))


def _is_row(each: Object) -> bool:
    return od.split_block(each.index)[1] == od.ROWS and bool(each.subindex)


def _is_computed(each: Object) -> bool:
    if each.index in _COMPUTED_ENTRIES or _is_measured(each.index) or od.is_program_download(each.index):
        return each.subindex != 0
    return each.index in _COMPUTED


def _is_measured(index: int) -> bool:
    return od.split_block(index)[1] in (od.SUMS, od.COUNTS)


def board_header(contract: Contract, boards: Sequence[Build]) -> str:
    """Return ``board.h``: sizes that hold every one of `boards`."""
    in_steps = boards[0].in_steps
    sizes: dict[str, tuple[object, str]] = {
        "SKIN_BOARDS": (len(boards), "boards of board.c"),
        "SKIN_BLOCKS": (max(each.node.blocks for each in boards), "blocks of a board"),
        "SKIN_BLOCK_SIZE": (contract.phi.block_size, "taxels of a block"),
        "SKIN_SUMS": (max(1, *(each.node.sums for each in boards)), "sums of a board"),
        "SKIN_TPDOS": (max(1, *(_tpdos(each.objects) for each in boards)), "TPDO communication records of a board"),
        "SKIN_PDO_BYTES": (max(each.node.pdo_bytes for each in boards), "longest payload of a PDO"),
        "SKIN_MAPPED": (max(1, *(_mapped(each.objects) for each in boards)), "most objects of a PDO"),
        "SKIN_STEPPED": (int(in_steps), "whether boards send steps"),
        "SKIN_PARTS": (max(1, *(len(each.node.forms) for each in boards)), "words of a board that sends steps"),
        "SKIN_ANALOGUE": (int(contract.layout.taxels.is_analogue), "whether converters read sums, not taxels"),
        "SKIN_SAMPLES": (
            1 if in_steps else contract.layout.samples_per_sync,
            "samples of each taxel in a cycle; more than 1 are averaged",
        ),
        "SKIN_WATCHED": (HEARTBEATS_WATCHED, "entries of 1016h"),
        "SKIN_ERRORS_KEPT": (ERRORS_KEPT, "entries of 1003h"),
        "SKIN_WINDOWS_MET": (WINDOWS_MET, "SYNCs without a missed window that end EMCY FF10h"),
        "SKIN_WRITABLE_BYTES": (max(each.objects.writable_bytes for each in boards), "values that SDO can write"),
    }
    rates = {each.board.bitrate for each in boards}
    timings = sum(1 << index for index, rate in enumerate(LSS_BIT_RATES_HZ) if rate in rates)
    sizes["SKIN_BIT_TIMINGS"] = timings, "bit n: bit timing n of LSS (CiA 305) is that of a board"
    lines = defined(sizes | _models(make_models(HORIZON) if in_steps else averaging_models(), HORIZON * in_steps))
    table = boards[0].board
    if len(boards) == 1:
        lines += [f"#define SKIN_BUS {boards[0].node.bus}", f"#define SKIN_NODE_ID {table.node_id}"]
    if len(by_type(boards)) == 1:
        lines += [
            f"#define SKIN_BITRATE {table.bitrate}",
            *([f"#define SKIN_DATA_BITRATE {table.data_bitrate}"] if table.data_bitrate else []),
        ]
    parts = ['#include "skin_board.h"', "", *lines, "", "extern const skin_board skin_boards[SKIN_BOARDS];"]
    return header("BOARD_H", f"Sizes of {names(boards)}.", parts)


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
    types = by_type(boards)
    number_of = {id(group[0].objects): number for number, group in enumerate(types)}
    parts = [_objects(number, group[0]) for number, group in enumerate(types)]
    rows = []
    for number, each in enumerate(boards):
        place = f"/* {each.board.bus}:{each.board.node_id} */"
        parts.append("\n".join([place, *array("static const uint8_t", f"own_{number}", each.own), ""]))
        kind = number_of[id(each.objects)]
        rows.append(f"    {{{each.node.bus}, {each.board.node_id}, {each.held}, &types[{kind}], own_{number}}},")
    return "\n".join(
        [
            f"/* Constants of {names(boards)}. {WRITTEN} */",
            '#include "board.h"',
            "",
            *parts,
            "static const skin_type types[] = {",
            *(_type(group[0], number) for number, group in enumerate(types)),
            "};",
            "",
            "const skin_board skin_boards[SKIN_BOARDS] = {",
            *rows,
            "};",
            "",
        ]
    )


def _objects(number: int, build: Build) -> str:
    """Return the arrays of a type."""
    rows = [
        f"    {{0x{index:04X}, {subindex}, 0x{flags:02X}, {at}, {length}}},"
        for index, subindex, flags, at, length in build.objects.entries
    ]
    first_sums = [*(each.first_sum for each in build.board.blocks), build.node.sums]
    return "\n".join(
        [
            "/* index, sub-index, flags, place, bytes */",
            f"static const skin_object objects_{number}[] = {{",
            *rows,
            "};",
            *array("static const uint16_t", f"first_sum_{number}", first_sums),
            *array("static const uint8_t", f"values_{number}", build.shared),
            "",
        ]
    )


def _type(build: Build, number: int) -> str:
    node, objects = build.node, build.objects
    packing = node.packing
    fields: dict[str, object] = {
        "blocks": node.blocks,
        "block_size": len(build.board.blocks[0].taxels),
        "count_max": build.board.count_max,
        "packing": f"{{{packing.bits}, {packing.scale.bit_length() - 1}, {packing.offset}}}",
        "first_sum": f"first_sum_{number}",
        "tpdos": _tpdos(objects),
        "pdo_bytes": node.pdo_bytes,
        "frame_flags": node.flags,
        "frame_ns": build.frame_ns,
        **(_words(node) if build.in_steps else {}),
        "objects": f"objects_{number}",
        "object_count": len(objects.entries),
        "communication_bytes": objects.communication_bytes,
        "writable_bytes": objects.writable_bytes,
        "own_first": objects.own_first,
        "own_from": objects.own_from,
        "own_middle": objects.own_middle,
        "values": f"values_{number}",
    }
    return "    {" + ", ".join(f".{name} = {value}" for name, value in fields.items()) + "},"


def _words(node: NodeContract) -> dict[str, object]:
    """Return the fields of a type that describe its frames of words: all parts of a node have the same form."""
    form = node.forms[0]
    return {
        "frame_bytes": node.tpdos[0].length,
        "frame_parts": node.frame_parts,
        "part_sums": form.sums,
        "radix": form.radix,
        "steps": f"{form.steps}u",
    }


def _tpdos(table: ObjectTable) -> int:
    return sum(od.TPDO_COMMUNICATION <= each.index < od.TPDO_MAPPING and not each.subindex for each in table.objects)


def _mapped(table: ObjectTable) -> int:
    """Return the room for mapped objects in the largest mapping record."""
    return max((each.subindex or 0 for each in table.objects if od.TPDO_MAPPING <= each.index < od.TPDO_END), default=0)


def names(boards: Sequence[Build]) -> str:
    """Return the boards as text for a comment."""
    first = boards[0].board
    more = f" and {len(boards) - 1} more boards" if len(boards) > 1 else ""
    return f"{first.bus}:{first.node_id}{more} of the skin {first.skin}"
