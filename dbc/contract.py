"""The bus contract: which node sends which sums in which frame of which SYNC cycle.

The first byte of every TPDO is 2022h: the SYNC counter (1019h) of the cycle in which its sums were sampled. So a frame
names its cycle, however late it comes.

With `sync.turns` = t the TPDOs of a node take turns: TPDO k answers the SYNCs of turn k mod t, which is transmission
type t with SYNC start value turn + 1.

The first byte of a stepped TPDO is the number of its slot (`dbc.steps`), and words of its parts follow.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from canskin.errors import LayoutError
from dbc import steps
from dbc.canopen import (
    HIGHEST_NODE_ID,
    NMT_COB_ID,
    SERVICES,
    SYNC_COB_ID,
    TIME_COB_ID,
    TPDO_BASES,
)
from dbc.frame import BRS, CLASSIC_BYTES, FD, FD_BYTES, FD_LENGTHS, Frames, frames, one_frame
from dbc.frame_bits import frame_time_ns
from dbc.packing import COUNTER_BYTES, Packing, packing
from skin.choice import SUMS_MAX
from skin.layout import SUM_BITS_MAX, SUM_BITS_MIN, Bus, Layout
from skin.phi import Sbhe
from skin.walsh import grouped_rows

#: Most bytes of one object in an SDO transfer; far above the size of any object of a node.
LONGEST_VALUE: Final = 256
#: The byte of 2005h that tells offset binary (1) tells words of steps by this.
_WORDS: Final = 3
#: The same byte with this added: sums of an analogue front end.
_ANALOGUE: Final = 4


@dataclass(frozen=True)
class Tpdo:
    """One transmit PDO: the SYNC counter and `sums` consecutive sums from `first_sum` on, at the SYNCs of its `turn`.

    With one turn `turn` is 0. `length` is the payload in bytes, with the padding of CAN FD.

    A stepped TPDO carries words of parts (`Contract.forms_of`): their sums are in the order of
    `skin.walsh.grouped_rows`, `first_sum` counts so, too, and `turn` is 0.
    """

    number: int
    cob_id: int
    turn: int
    first_sum: int
    sums: int
    length: int


@dataclass(frozen=True)
class NodeContract:
    """One CANopen node: `blocks` blocks of the skin from `block` on, and the frames it sends.

    `flags` are the flags of its PDOs (`dbc.frame`); all its other frames are classic. `forms` are those of the parts of
    a stepped node. A node that `is_optional` may be absent.
    """

    bus: int
    node_id: int
    block: int
    blocks: int
    sums: int
    packing: Packing
    flags: int
    tpdos: tuple[Tpdo, ...]
    forms: tuple[steps.Form, ...] = ()
    is_optional: bool = False

    @property
    def in_steps(self) -> bool:
        """Whether the node sends steps."""
        return bool(self.forms)

    @property
    def frame_parts(self) -> int:
        """Number of parts in each TPDO of a stepped node."""
        return len(self.forms) // len(self.tpdos)

    @property
    def pdo_bytes(self) -> int:
        """Longest payload of its PDOs."""
        return FD_BYTES if self.flags & FD else CLASSIC_BYTES

    @property
    def encoding(self) -> int:
        """Encoding of its PDOs as one number (2005h): width, log2 of the scale, offset binary, blocks.

        Words (`dbc.steps`) have their width, a 3 where others have 1 for offset binary, and no scale. Sums of an
        analogue front end (`skin.frontend`) have 4 or 5 there.
        """
        if self.in_steps:
            return 8 * steps.WORD_BYTES | _WORDS << 16 | self.blocks << 24
        step = self.packing.scale.bit_length() - 1
        form = (not self.packing.is_signed) + (0 if self.packing.converter is None else _ANALOGUE)
        return self.packing.bits | step << 8 | form << 16 | self.blocks << 24


@dataclass(frozen=True)
class Contract:
    """The bus protocol of a skin: all nodes and frames."""

    layout: Layout
    phi: Sbhe
    packing: Packing
    nodes: tuple[NodeContract, ...]

    @classmethod
    def from_layout(cls, layout: Layout) -> Self:
        """Compute all nodes and frames of a skin; LayoutError refuses a node with more sums than identifiers."""
        contract = cls(layout, *_phi_and_nodes(layout))
        _check_foreign(contract)
        return contract

    @property
    def in_steps(self) -> bool:
        """Whether the nodes send steps."""
        return self.nodes[0].in_steps

    @property
    def unit_n(self) -> float:
        """The unit of steps, newtons."""
        return steps.unit_n(self.layout.taxels.force_max_n, self.phi.block_size)

    @property
    def slots(self) -> int:
        """Number of slots of a stepped node from SYNC to SYNC."""
        return self.layout.slots

    @property
    def slot_cycle(self) -> int:
        """Number of slots after which their numbers come again."""
        return steps.slot_cycle(self.slots)

    @property
    def keep_max(self) -> int:
        """Number of slots after which a silent stepped node sends checks at the latest."""
        return steps.keep_max(self.slots)

    def forms_of(self, bus: int) -> tuple[steps.Form, ...]:
        """Return the forms of the parts of a stepped node on bus number `bus`: all its nodes have the same."""
        return self.on_bus(bus)[0].forms

    @property
    def turns(self) -> int:
        """Number of SYNCs in which every TPDO is sent once."""
        return self.layout.sync.turns

    def turn_of(self, sync_counter: int) -> int:
        """Return the turn of a SYNC counter value (1 to 240)."""
        return (sync_counter - 1) % self.turns

    @cached_property
    def sums_of_turn(self) -> list[npt.NDArray[np.intp]]:
        """Numbers of the sums that come in each turn."""
        parts = (self.table.gather[self.table.turn == turn] for turn in range(self.turns))
        return [part[part >= 0] for part in parts]

    @cached_property
    def needed(self) -> npt.NDArray[np.bool_]:
        """Blocks that a complete cycle has: those with sums, of nodes that are not optional; bool, shape (blocks,)."""
        needed = self.phi.has_sums.copy()
        for node in self.nodes:
            needed[node.block : node.block + node.blocks] &= not node.is_optional
        return needed

    def on_bus(self, bus: int) -> tuple[NodeContract, ...]:
        """Return the nodes of bus number `bus`, by node-ID."""
        return tuple(node for node in self.nodes if node.bus == bus)

    def identifiers(self, bus: int) -> dict[int, str]:
        """Return the 11-bit identifiers of all frames of the skin on bus number `bus`, with their meanings."""
        found = {NMT_COB_ID: "NMT", SYNC_COB_ID: "SYNC"}
        if self.layout.sync.time_s is not None:
            found[TIME_COB_ID] = "TIME"
        for node in self.on_bus(bus):
            found |= {base + node.node_id: f"{what} of node {node.node_id}" for base, what in SERVICES.items()}
            found |= {tpdo.cob_id: f"TPDO {tpdo.number} of node {node.node_id}" for tpdo in node.tpdos}
        return found

    def cycle(self, bus: int, turn: int = 0) -> Frames:
        """Return the frames of one cycle on a bus, SYNC first, then the TPDOs by identifier; all data 0."""
        sent = [(tpdo, node.flags) for node in self.on_bus(bus) for tpdo in node.tpdos if tpdo.turn == turn]
        sent.sort(key=lambda pair: pair[0].cob_id)
        tpdos = frames(len(sent))
        tpdos["can_id"] = [tpdo.cob_id for tpdo, _ in sent]
        tpdos["length"] = [tpdo.length for tpdo, _ in sent]
        tpdos["flags"] = [flags for _, flags in sent]
        cycle: Frames = np.concatenate([sync_frame(0), tpdos])
        return cycle

    def shortest_s(self, bus: int) -> float:
        """Return the least time of a TPDO on a bus, intermission included: the shortest, without stuff bits."""
        line, one = self.layout.bus[bus], frames(1)
        one["length"], one["flags"] = self.table.length[self.table.bus == bus].min(initial=FD_BYTES), frame_flags(line)
        return float(frame_time_ns(one, line.bitrate, line.data_bitrate, "none")[0]) * 1e-9

    def longest_ns(self, bus: int) -> int:
        """Return the most time of a TPDO on a bus, with all stuff bits that there may be, nanoseconds."""
        line, one = self.layout.bus[bus], frames(1)
        one["length"], one["flags"] = self.table.length[self.table.bus == bus].max(initial=0), frame_flags(line)
        return int(frame_time_ns(one, line.bitrate, line.data_bitrate, "worst")[0])

    @cached_property
    def table(self) -> "FrameTable":
        """All TPDOs of all buses as arrays."""
        return _table(self)

    @cached_property
    def parts(self) -> "PartTable":
        """All parts of stepped nodes as arrays."""
        return _parts(self)


class FrameTable(NamedTuple):
    """Every TPDO of the skin, one row each, ordered by bus, node and number; compiled code takes it as it is.

    Attributes
    ----------
    bus, node, turn, cob_id, length, flags : arrays of int, shape (rows,)
        `node` is the index in `Contract.nodes`.
    gather : array of int, shape (rows, width)
        Indices of the sums in each frame, padded with -1.
    row_of : array of int, shape (buses, 2048)
        Row of an 11-bit identifier on a bus, -1 for every other identifier.
    """

    bus: npt.NDArray[np.intp]
    node: npt.NDArray[np.intp]
    turn: npt.NDArray[np.intp]
    cob_id: npt.NDArray[np.uint32]
    length: npt.NDArray[np.uint8]
    flags: npt.NDArray[np.uint8]
    gather: npt.NDArray[np.intp]
    row_of: npt.NDArray[np.intp]


class PartTable(NamedTuple):
    """Every part of the stepped nodes of a skin, numbered by node, and the frames that carry them, for compiled code.

    Attributes
    ----------
    row_of : array of int, shape (buses, 2048)
        As in `FrameTable`: the frame of an 11-bit identifier on a bus, -1 for every other identifier.
    node, length, flags : arrays of int, shape (frames,)
        As in `FrameTable`.
    part, parts : arrays of int, shape (frames,)
        The first of a frame's parts, and how many follow each other in the frame.
    block, first : arrays of int, shape (parts,)
        Block of a part, and the place of its first sum in the block, in the order of `skin.walsh.grouped_rows`.
    form : array of int64, shape (parts, 5)
        The fields of `dbc.steps.Form`.
    """

    row_of: npt.NDArray[np.intp]
    node: npt.NDArray[np.intp]
    part: npt.NDArray[np.intp]
    parts: npt.NDArray[np.intp]
    length: npt.NDArray[np.uint8]
    flags: npt.NDArray[np.uint8]
    block: npt.NDArray[np.intp]
    first: npt.NDArray[np.intp]
    form: npt.NDArray[np.int64]


def sync_frame(sync_counter: int) -> Frames:
    """Return the SYNC frame of a counter value, which is its one byte."""
    return one_frame(SYNC_COB_ID, bytes((sync_counter,)))


def frame_flags(line: Bus) -> int:
    """Return the flags (`dbc.frame`) of the PDOs of a bus."""
    return FD | (BRS if line.data_bitrate else 0) if line.fd else 0


def _phi_and_nodes(layout: Layout) -> tuple[Sbhe, Packing, tuple[NodeContract, ...]]:
    """Return Φ, packing and nodes."""
    phi, pack = layout.phi(), packing(layout)
    nodes: list[NodeContract] = []
    for number, bus in enumerate(layout.bus):
        for place, node_id in enumerate(bus.ids):
            block = layout.first_block(number) + place * bus.blocks_per_node
            sums = range(int(phi.starts[block]), int(phi.starts[block + bus.blocks_per_node]))
            forms: tuple[steps.Form, ...] = ()
            if layout.sends.in_cycles:
                tpdos = _tpdos(bus, number, place, sums, pack.bits, turns=layout.sync.turns)
            else:
                forms = tuple(steps.forms(len(sums), is_fd=bus.fd))
                tpdos = _tpdos_of_parts(bus, number, place, sums, forms)
            flags, blocks = frame_flags(bus), bus.blocks_per_node
            is_optional = node_id in (bus.optional or ())
            node = NodeContract(number, node_id, block, blocks, len(sums), pack, flags, tpdos, forms, is_optional)
            nodes.append(node)
    return phi, pack, tuple(nodes)


def _tpdos_of_parts(bus: Bus, number: int, place: int, sums: range, forms: Sequence[steps.Form]) -> tuple[Tpdo, ...]:
    """Return the TPDOs of the stepped node at a place of a bus: one for each part, on CAN FD one for all."""
    together = len(forms) if bus.fd else 1
    of_frame = sum(form.sums for form in forms[:together])
    return tuple(
        Tpdo(
            number=index + 1,
            cob_id=_cob_id(bus, number, place, index),
            turn=0,
            first_sum=first,
            sums=of_frame,
            length=_length(together, 8 * steps.WORD_BYTES, fd=bus.fd),
        )
        for index, first in enumerate(sums[::of_frame])
    )


def _tpdos(bus: Bus, number: int, place: int, sums: range, bits: int, *, turns: int) -> tuple[Tpdo, ...]:
    """Divide the sums of the node at a place of a bus into frames."""
    return tuple(
        Tpdo(
            number=index + 1,
            cob_id=_cob_id(bus, number, place, index),
            turn=index % turns,
            first_sum=part.start,
            sums=len(part),
            length=_length(len(part), bits, fd=bus.fd),
        )
        for index, part in enumerate(_spread(sums, bits, fd=bus.fd, turns=turns))
    )


def useful_widths(sums: int, *, fd: bool) -> list[int]:
    """Return widths for `sums` sums of a node, the widest first: of those with the same frames and bytes the widest."""
    found: dict[tuple[int, int], int] = {}
    for bits in range(SUM_BITS_MAX, SUM_BITS_MIN - 1, -1):
        parts = _spread(range(sums), bits, fd=fd)
        found.setdefault((len(parts), sum(_length(len(part), bits, fd=fd) for part in parts)), bits)
    return list(found.values())


def _spread(sums: range, bits: int, *, fd: bool, turns: int = 1) -> list[range]:
    """Divide sums into the smallest number of frames, as many in each turn, with the fewest bytes in the longest turn.

    No frame is without sums, so fewer sums than turns are a frame each.
    """
    most = min(8 * ((FD_BYTES if fd else CLASSIC_BYTES) - COUNTER_BYTES) // bits, SUMS_MAX)
    fewest = min(-(-len(sums) // (most * turns)) * turns, len(sums))
    ways = [
        [sums[start : start + size] for start in range(0, len(sums), size)]
        for size in range(most, 0, -1)
        if -(-len(sums) // size) == fewest
    ]
    ways.append([sums[len(sums) * each // fewest : len(sums) * (each + 1) // fewest] for each in range(fewest)])

    def turn_bytes(parts: list[range]) -> list[int]:
        lengths = [_length(len(part), bits, fd=fd) for part in parts]
        return sorted((sum(lengths[turn::turns]) for turn in range(turns)), reverse=True)

    return min(ways, key=turn_bytes)


def _length(sums: int, bits: int, *, fd: bool) -> int:
    """Return the payload bytes of a frame with `sums` sums, or words, of `bits`, counter and padding included."""
    length = COUNTER_BYTES - (-sums * bits // 8)
    return next(each for each in FD_LENGTHS if each >= length) if fd else length


def _cob_id(bus: Bus, number: int, place: int, index: int) -> int:
    """Return the identifier of TPDO `index` of a node; beyond eight per node, identifiers of unused node-IDs."""
    turn, base = divmod(index, len(TPDO_BASES))
    free = (*bus.ids, *_spare_ids(bus))
    if place + turn * bus.nodes >= len(free):
        raise LayoutError(
            f"no identifiers left for TPDO {index + 1} of node {bus.ids[place]}: put fewer nodes on `$.bus[{number}]`"
        )
    return TPDO_BASES[base] + free[place + turn * bus.nodes]


@cache
def _spare_ids(bus: Bus) -> tuple[int, ...]:
    """Return the node-IDs that no node of the bus has, and no foreign message; those above the first node first."""
    taken = {*bus.ids, *(each.identifier & HIGHEST_NODE_ID for each in bus.foreign if not each.is_extended)}
    return tuple(sorted(set(range(1, HIGHEST_NODE_ID + 1)) - taken, key=lambda each: (each < bus.ids[0], each)))


def _check_foreign(contract: Contract) -> None:
    """Refuse a foreign message with an identifier of the skin's; name both."""
    for number, bus in enumerate(contract.layout.bus):
        known = contract.identifiers(number) if bus.foreign else {}
        for index, each in enumerate(bus.foreign):
            ours = None if each.is_extended else known.get(each.identifier)
            if ours is None:
                continue
            if each.identifier == SYNC_COB_ID:
                what = f"two SYNC producers on {bus.name}, {each.label} and the gateway: a bus of a skin has one"
                do = "clear bit 30 of 1005h in the other, or give its SYNC another identifier there"
            else:
                what = f"{each.label} and {ours} have the same identifier {each.identifier:03X}h on {bus.name}"
                do = "change `first_node_id` or `node_ids` of the bus, or the identifier in the other device"
            where = f"at `$.bus[{number}].foreign[{index}]`"
            raise LayoutError(f"layout {contract.layout.name}: {what}: {do} - {where}")


def _table(contract: Contract) -> FrameTable:
    rows = [(node, tpdo) for node in contract.nodes for tpdo in node.tpdos]
    node_of_row = [place for place, node in enumerate(contract.nodes) for _ in node.tpdos]
    gather = np.full((len(rows), max((tpdo.sums for _, tpdo in rows), default=0)), -1, np.intp)
    row_of = np.full((len(contract.layout.bus), 0x800), -1, np.intp)
    for row, (node, tpdo) in enumerate(rows):
        gather[row, : tpdo.sums] = places_of_sums(contract, node, tpdo)
        row_of[node.bus, tpdo.cob_id] = row
    return FrameTable(
        bus=np.array([node.bus for node, _ in rows], np.intp),
        node=np.array(node_of_row, np.intp),
        turn=np.array([tpdo.turn for _, tpdo in rows], np.intp),
        cob_id=np.array([tpdo.cob_id for _, tpdo in rows], np.uint32),
        length=np.array([tpdo.length for _, tpdo in rows], np.uint8),
        flags=np.array([node.flags for node, _ in rows], np.uint8),
        gather=gather,
        row_of=row_of,
    )


def places_of_sums(contract: Contract, node: NodeContract, tpdo: Tpdo) -> list[int]:
    """Return the places of a TPDO's sums among all sums, in the order of the frame."""
    sums = range(tpdo.first_sum, tpdo.first_sum + tpdo.sums)
    if not node.in_steps:
        return list(sums)
    start, rows = int(contract.phi.starts[node.block]), grouped_rows(node.sums).ravel()
    return [start + int(rows[each - start]) for each in sums]


def _parts(contract: Contract) -> PartTable:
    table, forms = contract.table, [form for node in contract.nodes for form in node.forms]
    block = np.array([node.block for node in contract.nodes for _ in node.forms], np.intp)
    parts = np.array([node.frame_parts for node in contract.nodes for _ in node.tpdos], np.intp)
    return PartTable(
        row_of=table.row_of,
        node=table.node,
        part=np.cumsum(parts) - parts,
        parts=parts,
        length=table.length,
        flags=table.flags,
        block=block,
        first=np.array([first for node in contract.nodes for first in _firsts(node.forms)], np.intp),
        form=np.array(forms, np.int64).reshape(-1, len(steps.Form._fields)),
    )


def _firsts(forms: Sequence[steps.Form]) -> list[int]:
    """Return the place of the first sum of each part."""
    return [sum(form.sums for form in forms[:part]) for part in range(len(forms))]
