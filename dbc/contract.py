"""The bus contract: which node sends which sums in which frame of which SYNC cycle.

A TPDO carries no cycle number, so a frame that is late by one cycle would pass for a fresh one. Here every node
owns one set of TPDOs per *phase*: with two phases, frames of odd SYNC counters and of even ones have different
COB-IDs. This is plain CiA 301: transmission type `PHASES` with SYNC start value `phase + 1`, and it costs no
payload bit. A frame that arrives one SYNC late has the wrong COB-ID and cannot count for the new cycle.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from skin.errors import LayoutError
from skin.layout import Bus, Layout
from skin.measurement import Sbhe

#: SYNC (CiA 301, 7.3.5: predefined connection set).
SYNC_COB_ID: Final = 0x080
NMT_COB_ID: Final = 0x000
EMCY_BASE: Final = 0x080
SDO_REQUEST_BASE: Final = 0x600
SDO_RESPONSE_BASE: Final = 0x580
HEARTBEAT_BASE: Final = 0x700
#: COB-IDs of TPDO 1 to 4 of the predefined connection set, then those of the RPDOs, which a skin node does not use.
TPDO_BASES: Final = (0x180, 0x280, 0x380, 0x480, 0x200, 0x300, 0x400, 0x500)

#: Sets of TPDOs that take turns, see the module's text.
PHASES: Final = 2
#: Synchronous counter overflow value (1019h): a multiple of `PHASES`, so that the turns go on across it.
SYNC_OVERFLOW: Final = 240
#: Payload of a classic CAN frame.
FRAME_BYTES: Final = 8
HIGHEST_NODE_ID: Final = 127


@dataclass(frozen=True)
class Tpdo:
    """One transmit PDO: `sums` consecutive sums from `first_sum` on, when the SYNC counter is in `phase`."""

    number: int
    cob_id: int
    phase: int
    first_sum: int
    sums: int
    first_subindex: int
    length: int


@dataclass(frozen=True)
class NodeContract:
    """One CANopen node: its `block` of the skin and the frames it sends."""

    bus: int
    node_id: int
    block: int
    sums: int
    tpdos: tuple[Tpdo, ...]


@dataclass(frozen=True)
class Contract:
    """Everything the two ends of the buses agree on; made by `contract`."""

    layout: Layout
    phi: Sbhe
    nodes: tuple[NodeContract, ...]

    def on_bus(self, bus: int) -> tuple[NodeContract, ...]:
        """Return the nodes of bus number `bus`, by node-ID."""
        return tuple(node for node in self.nodes if node.bus == bus)

    @cached_property
    def table(self) -> "FrameTable":
        """All TPDOs of all buses as arrays."""
        return _table(self)


@dataclass(frozen=True, eq=False)
class FrameTable:
    """Every TPDO of the skin, one row each, ordered by bus, node and number.

    Attributes
    ----------
    bus, block, phase, cob_id, length : arrays of int, shape (rows,)
    gather : array of int, shape (rows, 4)
        The sums in each frame; -1 where the frame has no further sum.
    row_of : array of int, shape (buses, 2048)
        Row of an 11-bit identifier on a bus, -1 for every other identifier.
    """

    bus: npt.NDArray[np.intp]
    block: npt.NDArray[np.intp]
    phase: npt.NDArray[np.intp]
    cob_id: npt.NDArray[np.uint32]
    length: npt.NDArray[np.uint8]
    gather: npt.NDArray[np.intp]
    row_of: npt.NDArray[np.intp]


def phase_of(sync_counter: int) -> int:
    """Return the phase of a SYNC counter value (1 to 240)."""
    return (sync_counter - 1) % PHASES


def next_counter(sync_counter: int) -> int:
    """Return the SYNC counter that follows (CiA 301, 7.2.5.1: 1 follows the overflow value)."""
    return sync_counter % SYNC_OVERFLOW + 1


def contract(layout: Layout) -> Contract:
    """Lay out all nodes and frames of a skin.

    Raises
    ------
    LayoutError
        If a node has more sums than its bus has identifiers for.
    """
    phi = layout.phi()
    nodes: list[NodeContract] = []
    for number, bus in enumerate(layout.bus):
        for node_id in range(1, bus.nodes + 1):
            block = layout.first_block(number) + node_id - 1
            first, last = int(phi.starts[block]), int(phi.starts[block + 1])
            tpdos = _tpdos(bus, number, node_id, first, last)
            nodes.append(NodeContract(number, node_id, block, last - first, tpdos))
    return Contract(layout, phi, tuple(nodes))


def _tpdos(bus: Bus, number: int, node_id: int, first: int, last: int) -> tuple[Tpdo, ...]:
    """Spread the sums `first` to `last` over full frames, once per phase."""
    per_frame = FRAME_BYTES // 2
    starts = range(first, last, per_frame)
    tpdos = []
    for index in range(PHASES * len(starts)):
        phase, frame = divmod(index, len(starts))
        sums = min(per_frame, last - starts[frame])
        tpdos.append(
            Tpdo(
                number=index + 1,
                cob_id=_cob_id(bus, number, node_id, index),
                phase=phase,
                first_sum=starts[frame],
                sums=sums,
                first_subindex=starts[frame] - first + 1,
                length=2 * sums,
            )
        )
    return tuple(tpdos)


def _cob_id(bus: Bus, number: int, node_id: int, index: int) -> int:
    """Give TPDO `index` its identifier; beyond eight per node, those of node-IDs the bus does not use."""
    turn, base = divmod(index, len(TPDO_BASES))
    low = node_id + turn * bus.nodes
    if low > HIGHEST_NODE_ID:
        raise LayoutError(
            f"no identifiers left for TPDO {index + 1} of node {node_id}: put fewer nodes on `$.bus[{number}]`"
        )
    return TPDO_BASES[base] + low


def _table(made: Contract) -> FrameTable:
    rows = [(node, tpdo) for node in made.nodes for tpdo in node.tpdos]
    gather = np.full((len(rows), FRAME_BYTES // 2), -1, np.intp)
    row_of = np.full((len(made.layout.bus), 0x800), -1, np.intp)
    for row, (node, tpdo) in enumerate(rows):
        gather[row, : tpdo.sums] = range(tpdo.first_sum, tpdo.first_sum + tpdo.sums)
        row_of[node.bus, tpdo.cob_id] = row
    return FrameTable(
        bus=np.array([node.bus for node, _ in rows], np.intp),
        block=np.array([node.block for node, _ in rows], np.intp),
        phase=np.array([tpdo.phase for _, tpdo in rows], np.intp),
        cob_id=np.array([tpdo.cob_id for _, tpdo in rows], np.uint32),
        length=np.array([tpdo.length for _, tpdo in rows], np.uint8),
        gather=gather,
        row_of=row_of,
    )
