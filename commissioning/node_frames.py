"""What a board shows in a check, and the comparison of its frames with those that the contract computes.

A board shows the test patterns, and then `distinct_counts`: gains of 0, and offsets in place of the taxels. The test
patterns alone are equal in most rows of Φ; these counts are different in every row.
"""

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc import indices as od
from dbc.board import BoardTpdo, board
from dbc.board_sums import (
    PATTERN_FULL,
    PATTERN_OFF,
    PATTERN_RAMP,
    PATTERN_ZERO,
    calibration_values,
    node_payloads,
    node_sums,
    pattern_counts,
)
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract, NodeContract
from dbc.dictionary import window_s
from dbc.frame import ECHO, Frames
from skin.phi import fast_hadamard

#: SYNC messages between the begin of a picture and the first cycle that is compared: a board may be slow to start.
SETTLING: Final = 2
#: SYNC messages of each picture, or more (`ExpectedFrames.cycles`).
CYCLES: Final = 4
#: Arrangements of which `distinct_counts` takes the one with the largest sums.
_DRAWS: Final = 16
#: Mean and amplitude of `distinct_counts`, parts of full scale.
_MEAN, _AMPLITUDE = 0.7, 0.28
#: Largest offset (2011h, INTEGER16).
_LARGEST_OFFSET: Final = 0x7FFF
Values = Mapping[tuple[int, int], bytes]


@dataclass
class NodeReport:
    """What a check has found.

    Attributes
    ----------
    bus : str
    node_id : int
    differences : list of str
        What differs from the contract; the board keeps it if there are none.
    notes : list of str
        What is allowed and costs something.
    objects, frames, cycles : int
        Number of objects, TPDOs and cycles that were compared.
    latest_s : float
        Latest end of a TPDO after the SYNC; 0 of stepped boards.
    """

    bus: str
    node_id: int
    differences: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    objects: int = 0
    frames: int = 0
    cycles: int = 0
    latest_s: float = 0.0


@dataclass(frozen=True)
class Picture:
    """What a board shows in place of its taxels.

    Attributes
    ----------
    name : str
    values : mapping
        The objects to be written, by index and sub-index.
    counts : array of float32, shape (blocks, block size)
        In chain order.
    is_step : bool
        Written while the board is OPERATIONAL.
    """

    name: str
    values: Values
    counts: npt.NDArray[np.float32]
    is_step: bool = False


def syncs_of(came: Frames) -> npt.NDArray[np.intp]:
    """Return the places of the SYNC messages that the check has sent."""
    return np.flatnonzero((came["can_id"] == SYNC_COB_ID) & (came["flags"] & ECHO != 0))


def distinct_counts(rows: npt.NDArray[np.integer], size: int, top: int) -> npt.NDArray[np.int32]:
    """Return counts of a chain of `size` places, of which no two of `rows` have the same sum, and none but row 0 0.

    Parameters
    ----------
    rows : array of int
        Rows of the Hadamard matrix.
    top : int
        Largest count.
    """
    random, best = np.random.default_rng(0), np.zeros(size)
    for _ in range(_DRAWS):
        sums = np.zeros(size)
        sums[rows] = random.permutation(1 + np.arange(len(rows))) * (-1) ** np.arange(len(rows))
        sums[0] = 0
        shape = np.asarray(fast_hadamard(sums), np.float64)
        shape /= max(1.0, np.abs(shape).max())
        best = max(best, shape, key=lambda each: float(np.square(each).sum()))
    return np.rint(top * (_MEAN + _AMPLITUDE * best)).astype(np.int32)


class ExpectedFrames(ABC):
    """The frames of a board in a check; what differs goes into `report`.

    Attributes
    ----------
    rest_s : float
        Pause between the write of a picture and the NMT start.
    cycles : int
        SYNC messages of each picture.
    """

    rest_s: float = 0.0
    cycles = CYCLES
    _patterns: tuple[int, ...]

    def __init__(self, contract: Contract, node: NodeContract, report: NodeReport) -> None:
        self._contract, self._node, self._report = contract, node, report

    def pictures(self, *, has_gains: bool) -> Iterator[Picture]:
        """Return what the board is to show, in this order; `has_gains`: the board has 2010h and 2011h."""
        size, top = self._contract.phi.block_size, self._contract.layout.taxels.count_max
        shape = self._node.blocks, size
        for pattern in self._patterns:
            counts = np.zeros(shape, np.float32)
            if pattern == PATTERN_OFF:
                if not has_gains:
                    continue
                for place in range(self._node.blocks):
                    rows = np.array(self._contract.phi.rows_of(self._node.block + place), np.intp)
                    counts[place] = distinct_counts(rows, size, min(top, _LARGEST_OFFSET))
                values = calibration_values(np.zeros(shape, np.float32), counts, PATTERN_OFF)
                yield Picture("offsets in place of the taxels", values, counts)
            else:
                counts[:] = pattern_counts(pattern, size, top)
                values = {(od.of_block(od.TEST_PATTERN, place), 0): bytes((pattern,)) for place in range(shape[0])}
                name = {PATTERN_ZERO: "zero", PATTERN_RAMP: "ramp", PATTERN_FULL: "full scale"}[pattern]
                yield Picture(f"test pattern {name}", values, counts, self._node.in_steps and pattern == PATTERN_ZERO)

    def hear(self, arrived: Frames) -> None:  # noqa: B027  not all need it
        """Take all frames that arrive, with the echoes of those of the check."""

    @abstractmethod
    def compare(self, came: Frames, picture: Picture, values: Values) -> None:
        """Compare what came, from the frame that began the picture on; `values` are those of objects."""

    def _differs(self, text: str) -> None:
        self._report.differences.append(text)


class SynchronousFrames(ExpectedFrames):
    """The frames of a board that sends at SYNC: each TPDO of each cycle, byte for byte."""

    _patterns = (PATTERN_ZERO, PATTERN_RAMP, PATTERN_FULL, PATTERN_OFF)

    def __init__(self, contract: Contract, node: NodeContract, report: NodeReport) -> None:
        super().__init__(contract, node, report)
        self._tpdos = board(contract, node).tpdos

    def compare(self, came: Frames, picture: Picture, values: Values) -> None:  # noqa: ARG002
        """Compare the TPDOs of all cycles of a picture."""
        sums = node_sums(self._contract, self._node, picture.counts)
        window_us = round(window_s(self._contract.layout) * 1e6)
        syncs = [*syncs_of(came)[SETTLING:].tolist(), len(came)]
        #: What differs, by its kind and TPDO.
        found: defaultdict[tuple[str, int], list[str]] = defaultdict(list)
        for counter in range(1, CYCLES + 1):
            place = f"{picture.name}, SYNC {counter}"
            self._report.cycles += 1
            if counter >= len(syncs):
                found["SYNC", 0].append(f"{place}: the SYNC was not sent")
                continue
            cycle = came[syncs[counter - 1] : syncs[counter]]
            payloads = node_payloads(self._contract, self._node, int(cycle["data"][0, 0]), sums)
            for tpdo in self._tpdos:
                copies = cycle[(cycle["can_id"] == tpdo.cob_id) & (cycle["flags"] & ECHO == 0)]
                is_due = _is_due(tpdo, counter)
                what = f"{place}: TPDO {tpdo.number} ({tpdo.cob_id:03X}h)"
                if len(copies) != is_due:
                    text = f"{what} came {len(copies)} times, expected {int(is_due)}"
                    found["came", tpdo.number].append(text)
                if not len(copies):
                    continue
                self._report.frames += 1
                data, payload = copies[0]["data"][: copies[0]["length"]].tobytes(), payloads[tpdo.cob_id]
                if data != payload:
                    text = f"{what} is {data.hex(' ')}, expected {payload.hex(' ')}"
                    found["is", tpdo.number].append(text)
                late_s = (int(copies["time_ns"].max()) - int(cycle["time_ns"][0])) / 1e9
                self._report.latest_s = max(self._report.latest_s, late_s)
                if late_s * 1e6 > window_us:
                    late = f"TPDO {tpdo.number} ends {late_s * 1e3:.1f} ms after SYNC"
                    found["late", tpdo.number].append(f"{place}: {late}, after 1007h")
        for first, *others in found.values():
            self._differs(first + (f", and so in {len(others)} more of {CYCLES} cycles" if others else ""))


def _is_due(tpdo: BoardTpdo, counter: int) -> bool:
    """Tell whether a TPDO answers the SYNC `counter`, the first after the start being 1."""
    return (counter - tpdo.sync_start_value) % tpdo.transmission_type == 0
