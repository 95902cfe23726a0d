"""Test vectors for the firmware of an adaptive board: samples, what its filter makes of them, its frames, as JSON."""

from collections.abc import Iterable, Iterator
from functools import reduce
from operator import add
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from dbc.adaptive import (
    FINE_LIMIT,
    GROUP_SUMS,
    NO_CHECK,
    Companding,
    SendingRule,
    carried,
    check_of,
    coarse_code,
    coarse_value,
    fine_steps,
    hold,
    pack_fine,
)

from dbc.adaptive_filter import (
    HORIZON,
    IDLE_SAMPLES,
    LOG2_SERIES,
    POWER,
    SETTLING_SAMPLES,
    make_models,
    unclip_table,
)
from dbc.board import json_text
from dbc.board_sums import PATTERN_OFF, calibration_signature, calibration_values
from dbc.contract import Contract, NodeContract
from nodes.adaptive.filtering import PatchFilter
from nodes.adaptive.noise import IdleStatistics, Noise
from nodes.adaptive.sending import (
    NOT_DUE,
    ask,
    decide,
    make_payload,
    new_groups,
    noise_threshold_n2,
    note_sent,
    tpdo_of,
)
from skin.walsh import patch_shape

#: Samples of a board that sends.
SAMPLES: Final = 1000
#: When a touch begins, when it stops to slide, and when it ends.
_PRESSED, _STOPPED, _RELEASED = 120, 400, 900
#: When others have the bus: while the touch slides, so that news waits; while it rests, so that refreshes do.
_BUSY: Final = (range(200, 240), range(560, 870))
#: When somebody asks for groups again, and for which: bits of 2030h.
_REQUESTED, _REQUEST = 300, 0b0101
#: Sensor noise and forces, parts of a taxel's full scale. Three taxels are defective: by place.
_NOISE, _PRESS, _REST = 0.05, 0.45, 0.3
_SHIFTED, _SHIFT, _DEAD, _NOISY, _NOISIER = 5, 0.15, 17, 26, 3.0
_WIDTH_TAXELS: Final = 1.3
#: As 2031h holds it: REAL32, or whole.
_RULE: Final = SendingRule._make(
    float(np.float32(value)) if isinstance(value, float) else value for value in SendingRule()
)


class _Sample(NamedTuple):
    """Counts of all taxels, and what happens on the bus."""

    counts: npt.NDArray[np.uint16]
    is_busy: bool
    request: int


def adaptive_vectors_text(contract: Contract, node: NodeContract) -> str:
    """Return the test vectors of an adaptive board as JSON."""
    random = np.random.default_rng(node.block)
    idle = [_read(contract, np.zeros(contract.phi.block_size), random) for _ in range(IDLE_SAMPLES + SETTLING_SAMPLES)]
    board = _Board(contract, node, idle)
    return json_text(
        {
            "bus": contract.layout.bus[node.bus].name,
            "node_id": node.node_id,
            "signatures": [_signed(contract, node, *values) for values in ((1.0, 0), (0.5, -3))],
            "tables": _tables(),
            "codes": [_coded(contract.law, *sums) for sums in _code_cases(contract, random)],
            "power_up": {"counts": [each.tolist() for each in idle], **board.learned()},
            "samples": [board.take(each) for each in _samples(contract, random)],
        }
    )


def _signed(contract: Contract, node: NodeContract, gain: float, offset: int) -> dict[str, object]:
    """Return 2009h with this gain at the first place, and this offset at the last."""
    gains, offsets = np.ones((1, contract.phi.block_size), np.float32), np.zeros((1, contract.phi.block_size), int)
    gains[0, 0], offsets[0, -1] = gain, offset
    signed = calibration_signature(contract, node, calibration_values(gains, offsets, PATTERN_OFF))
    return {"gain": gains[0].tolist(), "offset_counts": offsets[0].tolist(), "calibration_signature": signed}


def _tables() -> dict[str, object]:
    """Return the numbers of the filter that are not in the documents, binary32 but for the logarithm's."""
    models = make_models(HORIZON)
    return {
        **{name: _reals(values) for name, values in models._asdict().items()},
        "power": _reals(POWER),
        "unclip": _reals(unclip_table()),
        "log2": LOG2_SERIES,
    }


def _reals(values: Iterable[Any]) -> list[float]:
    """Return binary32 numbers in as few digits as tell them apart."""
    return [float(f"{value:.9g}") for value in values]


# --- codes ----------------------------------------------------------------------------------------------------


def _code_cases(contract: Contract, random: np.random.Generator) -> Iterator[tuple[str, Any, Any]]:
    """Yield the name of a case, sums of a coarse frame of each group, and sums of the fine frames that follow."""
    law, size = contract.law, contract.phi.block_size
    top_n = contract.layout.taxels.force_max_n * size
    none = np.zeros(size, np.float32)
    yield "nothing", none, none
    most = np.full(size, -top_n / 2, np.float32)
    most[0] = top_n
    yield "the largest sums", most, most
    for number in range(8):
        size_n = 10 ** random.uniform(-5, np.log10(top_n / 2), size)
        sums_n = (size_n * random.choice((-1, 1), size)).astype(np.float32)
        sums_n[0] = 2 * abs(sums_n[0])
        reach = random.integers(-FINE_LIMIT + 1, FINE_LIMIT, size) * law.fine_n
        held_n = [coarse_value(_code(value, place, law), place == 0, law) for place, value in enumerate(sums_n)]
        yield f"random {number + 1}", sums_n, np.asarray(held_n + reach, np.float32)


def _code(value_n: float, place: int, law: Companding) -> int:
    return int(coarse_code(float(value_n), place == 0, law))


def _coded(law: Companding, name: str, sums_n: Any, later_n: Any) -> dict[str, object]:
    """Return the payloads of a case and what a receiver then holds; the frames are those of a classic bus."""
    groups, (held_n, coarse_n) = len(sums_n) // GROUP_SUMS, np.zeros((2, len(sums_n)))
    check, coarse, fine = np.full(groups, NO_CHECK, np.int64), [], []
    for group in range(groups):
        places = range(GROUP_SUMS * group, GROUP_SUMS * (group + 1))
        payload = np.array([_code(sums_n[place], place, law) for place in places], np.uint8)
        coarse.append(payload.tobytes().hex())
        hold(payload, group, False, False, law, held_n, coarse_n, check)
        refined = np.zeros(GROUP_SUMS, np.uint8)
        steps = np.array([fine_steps(float(later_n[place]), law) for place in places])
        pack_fine(steps, check_of(payload), refined)
        fine.append(refined.tobytes().hex())
        hold(refined, group, True, False, law, held_n, coarse_n, check)
    return {
        "name": name,
        "sums_n": _reals(sums_n),
        "coarse": coarse,
        "coarse_values_n": coarse_n.tolist(),
        "later_sums_n": _reals(later_n),
        "fine": fine,
        "fine_values_n": held_n.tolist(),
    }


# --- samples --------------------------------------------------------------------------------------------------


def _samples(contract: Contract, random: np.random.Generator) -> Iterator[_Sample]:
    """Yield a touch that comes, slides over the patch, rests and goes."""
    high, wide = patch_shape(contract.phi.block_size)
    request = _REQUEST & (1 << contract.layout.groups) - 1
    row, column = np.indices((high, wide)).reshape(2, -1)
    for now in range(SAMPLES):
        slid = min(1.0, max(0, now - _PRESSED) / (_STOPPED - _PRESSED))
        away = np.square(row - 0.5 - (high - 2.5) * slid) + np.square(column - 1 - (wide - 3) * slid)
        press = min(1.0, max(0, now - _PRESSED) / 6) * (_PRESS if now < _STOPPED + 20 else _REST)
        press *= min(1.0, max(0, _RELEASED + 5 - now) / 5)
        counts = _read(contract, press * np.exp(-away / _WIDTH_TAXELS**2), random)
        yield _Sample(counts, any(now in each for each in _BUSY), request if now == _REQUESTED else 0)


def _read(contract: Contract, touch: npt.NDArray[np.float64], random: np.random.Generator) -> npt.NDArray[np.uint16]:
    """Return what the taxels read under forces that are parts of the full scale."""
    size = touch.size
    spread, felt = np.full(size, _NOISE), touch.copy()
    spread[_NOISY % size] *= _NOISIER
    felt[_SHIFTED] += _SHIFT
    felt += spread * random.normal(size=size)
    felt[_DEAD % size] = 0
    counts: npt.NDArray[np.uint16] = np.rint(np.clip(felt, 0, 1) * contract.layout.taxels.count_max).astype(np.uint16)
    return counts


class _Board:
    """The board: it has learned from `idle` samples, and becomes OPERATIONAL before its next sample."""

    def __init__(self, contract: Contract, node: NodeContract, idle: list[npt.NDArray[np.uint16]]) -> None:
        self._law, self._newton_per_count = contract.law, contract.layout.taxels.newton_per_count
        statistics = IdleStatistics(1, contract.phi.block_size)
        for counts in idle[:IDLE_SAMPLES]:
            statistics.take(self._newtons(counts))
        self._learned: Noise = statistics.noise()
        self._filter = PatchFilter(self._learned, contract.phi.held[[node.block]])
        for counts in idle[IDLE_SAMPLES:]:
            self._filter.take(self._newtons(counts))
        self._tpdos = node.adaptive_tpdos
        self._is_fd = self._tpdos[0].is_fd
        self._count = contract.layout.groups
        self._groups = new_groups(1, self._count, self._is_fd)
        self._now = 0
        for group in range(self._count):
            ask(0, group, self._now, self._groups)

    def _newtons(self, counts: npt.NDArray[np.uint16]) -> npt.NDArray[np.float32]:
        return counts[None].astype(np.float32) * np.float32(self._newton_per_count)

    def learned(self) -> dict[str, object]:
        """Return what was learned of idle samples, and what the filter has made of it by the newest sample."""
        of_idle, now = self._learned, self._filter.noise
        return {
            "offset_n": _reals(of_idle.offset_n[0]),
            "learned": _noise(of_idle),
            "settled": {**_noise(now), "sums_n": _reals(self._filter.sums_n[0])},
        }

    def take(self, sample: _Sample) -> dict[str, object]:
        """Take a sample; return it with sums, variances and frames."""
        for group in range(self._count):
            if sample.request >> group & 1:
                ask(0, group, self._now, self._groups)
        self._now += 1
        self._filter.take(self._newtons(sample.counts))
        variance_n2 = self._filter.variance_n2[0].astype(np.float64)
        return {
            "request": sample.request,
            "is_busy": sample.is_busy,
            "counts": sample.counts.tolist(),
            "sums_n": _reals(self._filter.sums_n[0]),
            "variance_n2": [reduce(add, of_group) for of_group in variance_n2.reshape(-1, GROUP_SUMS).tolist()],
            "frames": self._frames(is_busy=sample.is_busy),
        }

    def _frames(self, *, is_busy: bool) -> list[dict[str, object]]:
        """Return the frames of the newest sample: they are sent at once, or come back from a busy bus."""
        sums_n, groups = self._filter.sums_n[0], self._groups
        noise_n2 = float(noise_threshold_n2(self._filter.noise.node_n, _RULE.noise_ratio, len(sums_n))[0])
        decide(0, self._now, sums_n, self._filter.variance_n2[0], noise_n2, _RULE, self._law, groups)
        due = [group for group in range(self._count) if groups.level[0, group] != NOT_DUE]
        due.sort(key=lambda group: int(tpdo_of(0, group, groups)))
        found: list[dict[str, object]] = []
        together, told = carried(self._count, self._is_fd), set[int]()
        for group in due:
            if group // together in told:
                continue
            told.add(group // together)
            tpdo = self._tpdos[tpdo_of(0, group, groups) // together]
            payload = np.zeros(tpdo.length, np.uint8)
            make_payload(0, group, sums_n, self._law, groups, payload)
            if not is_busy:
                note_sent(0, tpdo.group, self._now, tpdo.is_fine, _RULE, self._law, groups, payload)
            found.append({"cob_id": tpdo.cob_id, "data": payload.tobytes().hex()})
        return found


def _noise(noise: Noise) -> dict[str, object]:
    """Return the noise of the first board."""
    return {
        "taxel_noise_n": _reals(noise.taxel_n[0]),
        "coefficient_noise_n": _reals(noise.coefficient_n[0]),
        "board_noise_n": float(noise.node_n[0]),
    }
