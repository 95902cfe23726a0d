"""Test vectors for the firmware of a board: counts, what they become, and the bytes on the bus, as JSON."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from dbc.board import json_text
from dbc.board_sums import (
    PATTERN_FULL,
    PATTERN_OFF,
    PATTERN_RAMP,
    PATTERN_ZERO,
    calibration_signature,
    calibration_values,
    node_payloads,
    node_sums,
    shown_counts,
)
from dbc.contract import Contract, NodeContract
from skin.phi import fast_hadamard

#: No sum of averages is nearer to a tie of rounding: any float32 arithmetic then gives the same sum.
_TIE_MARGIN: Final = 0.02
#: Of the SYNC of every case: a byte with its highest bit set. TPDOs of the second turn answer the next SYNC.
_SYNC_COUNTER: Final = 0xA5
_FLOAT_MAX: Final = float(np.finfo(np.float32).max)

_PATTERN_NAMES: Final = {"zero": PATTERN_ZERO, "ramp": PATTERN_RAMP, "full scale": PATTERN_FULL}
_Floats = npt.NDArray[np.float32]


@dataclass(frozen=True)
class _Case:
    """Inputs of a board: arrays of shape (blocks, block size) in chain order, and one test pattern for all blocks."""

    name: str
    counts: npt.NDArray[Any]
    gain: _Floats
    offset: _Floats
    pattern: int = PATTERN_OFF


def vectors_text(contract: Contract, node: NodeContract) -> str:
    """Return the test vectors of a synchronous board as JSON.

    A board that makes its sums in hardware has no counts of taxels: its cases are the test patterns.
    """
    solve = _pattern if contract.layout.taxels.is_analogue else _solved
    cases = [solve(contract, node, case) for case in _cases(contract, node)]
    return json_text({"bus": contract.layout.bus[node.bus].name, "node_id": node.node_id, "cases": cases})


def _solved(contract: Contract, node: NodeContract, case: _Case) -> dict[str, object]:
    """Return inputs, intermediate results and frames of a case."""
    shown = shown_counts(contract, case.counts, case.gain, case.offset, np.full(node.blocks, case.pattern))
    sums = node_sums(contract, node, shown)
    of_turns = [node_payloads(contract, node, _SYNC_COUNTER + turn, sums) for turn in range(contract.turns)]
    values = calibration_values(case.gain, case.offset, case.pattern)
    return {
        "name": case.name,
        "pattern": case.pattern,
        "counts": case.counts.tolist(),
        "gain": case.gain.tolist(),
        "offset_counts": case.offset.astype(int).tolist(),
        "calibration_signature": calibration_signature(contract, node, values),
        "corrected": shown.tolist() if contract.layout.samples_per_sync > 1 else shown.astype(int).tolist(),
        "sums": sums.tolist(),
        "raw": contract.packing.raw(sums).tolist(),
        "sync_counter": _SYNC_COUNTER,
        "frames": [{"cob_id": each.cob_id, "data": of_turns[each.turn][each.cob_id].hex()} for each in node.tpdos],
    }


def _pattern(contract: Contract, node: NodeContract, case: _Case) -> dict[str, object]:
    """Return the pattern, the sums and the frames of a case."""
    solved = _solved(contract, node, case)
    return {key: solved[key] for key in ("name", "pattern", "sums", "raw", "sync_counter", "frames")}


def _cases(contract: Contract, node: NodeContract) -> Iterator[_Case]:
    top = contract.layout.taxels.count_max
    shape = (node.blocks, contract.phi.block_size)
    one, none = np.ones(shape, np.float32), np.zeros(shape, np.float32)
    second = np.zeros(shape, int)
    # Half a step, where sums are rounded: ties of both signs.
    second[:, 1] = max(1, contract.packing.scale // 2)
    if contract.layout.taxels.is_analogue:
        for name, pattern in _PATTERN_NAMES.items():
            yield _Case(f"test pattern: {name}", np.zeros(shape, int), one, none, pattern)
        return
    yield _Case("all taxels 0", np.zeros(shape, int), one, none)
    yield _Case("all taxels at full scale", np.full(shape, top), one, none)
    yield _Case("one taxel: place 1", second, one, none)
    sign = np.where(np.arange(shape[1]) % 2, -one, one)
    yield _Case("products out of range", np.full(shape, min(top, 3)), (_FLOAT_MAX * sign).astype(np.float32), none)
    draw = _Draw(contract, node)
    yield draw.clear(lambda: _Case("random", draw.counts(), one, none))
    yield draw.clear(lambda: _Case("gain and offset", draw.counts(), draw.gain(), draw.offset(top / 40)))
    yield draw.clear(lambda: _Case("limited to 0 and to full scale", draw.counts(), 2 * one, draw.offset(top)))
    if contract.layout.samples_per_sync == 1:
        yield _Case("ties to even", draw.counts(), np.full(shape, 0.5, np.float32), none)
        if unfused := _unfused(shape, top):
            yield _Case("product rounded before the offset is added", *unfused)
    for name, pattern in _PATTERN_NAMES.items():
        yield _Case(f"test pattern: {name}", draw.counts(), draw.gain(), draw.offset(top / 40), pattern)


class _Draw:
    """Random inputs of a board, always the same."""

    def __init__(self, contract: Contract, node: NodeContract) -> None:
        self._contract, self._node = contract, node
        self._shape = (node.blocks, contract.phi.block_size)
        self._random = np.random.default_rng(node.block)

    def counts(self) -> npt.NDArray[Any]:
        """Return ADC counts, or averages: multiples of 1/16."""
        top = self._contract.layout.taxels.count_max
        drawn = self._random.integers(0, top + 1, self._shape)
        if self._contract.layout.samples_per_sync == 1:
            return drawn
        return np.minimum(drawn + self._random.integers(0, 16, self._shape) / 16, top)

    def gain(self) -> _Floats:
        return self._random.uniform(0.8, 1.2, self._shape).astype(np.float32)

    def offset(self, most: float) -> _Floats:
        limit = min(most, np.iinfo(np.int16).max)
        return np.rint(self._random.uniform(-limit, limit, self._shape)).astype(np.float32)

    def clear(self, make: Callable[[], _Case]) -> _Case:
        """Draw a case until no sum is near a tie."""
        while True:
            case = make()
            shown = shown_counts(self._contract, case.counts, case.gain, case.offset, np.zeros(self._node.blocks, int))
            sums = np.asarray(fast_hadamard(shown.astype(np.float64)), np.float64)
            if np.abs(sums % 1 - 0.5).min() > _TIE_MARGIN:
                return case


def _unfused(shape: tuple[int, int], top: int) -> tuple[npt.NDArray[Any], _Floats, _Floats] | None:
    """Return counts, gain and offset that a fused multiply-add corrects to another integer; None if there are none.

    The product is a tie after rounding and none before. The offset takes away most of it, so that a fused sum keeps
    the difference.
    """
    counts = np.arange(3, top + 1)
    floor = counts - counts // 7
    gain = ((floor + 0.5) / counts).astype(np.float32)
    exact = gain.astype(np.float64) * counts
    base = np.where(exact > floor + 0.5, 20, 21)
    offset = base - floor
    separate = np.rint((gain * counts.astype(np.float32)) + offset.astype(np.float32))
    fused = np.rint((exact + offset).astype(np.float32))
    found = np.nonzero((separate != fused) & (separate <= top) & (offset >= np.iinfo(np.int16).min))[0]
    if not found.size:
        return None
    places = np.resize(found, shape)
    return counts[places], gain[places], offset[places].astype(np.float32)
