"""Test vectors for the firmware of a stepped board: samples, what its filter makes of them, its frames, as JSON."""

from collections.abc import Iterable, Iterator
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.board import json_text
from dbc.board_sums import PATTERN_OFF, calibration_signature, calibration_values
from dbc.contract import Contract, NodeContract
from dbc.frame import ECHO, ERROR, frames
from dbc.frame_fields import Integers
from dbc.patch_filter import (
    HORIZON,
    IDLE_SAMPLES,
    POWER,
    SAMPLE_NS,
    SETTLING_SAMPLES,
    make_models,
    unclip_table,
)
from dbc.steps import (
    COUNT,
    SCALES,
    SET_SUMS,
    SLOTS,
    WORD_BYTES,
    Form,
    check_word,
    limits,
    set_word,
    step_word,
    write_word,
)
from nodes.steps.filtering import PatchFilter
from nodes.steps.noise import IdleStatistics, Noise
from nodes.steps.sending import Senders
from skin.sync_counter import SYNC_OVERFLOW
from skin.walsh import patch_shape

#: Samples of a board that sends, and time from its first SYNC, which comes with the first sample, to that sample.
SAMPLES: Final = 1000
SINCE_SYNC_NS: Final = SAMPLE_NS // 2
#: Counter of the first SYNC: the counter begins anew meanwhile.
_FIRST_COUNTER: Final = 236
#: When a touch begins, when it stops to slide, and when it ends.
_PRESSED, _STOPPED, _RELEASED = 120, 400, 900
#: When frames are not sent but given up, and when they stay in the controller until the end of the time.
_LOST: Final = range(200, 240)
_HELD: Final = range(430, 500)
#: When somebody asks for all sums (2030h).
_REQUESTED: Final = 300
#: Sensor noise and forces, parts of a taxel's full scale. Three taxels are defective: by place.
_NOISE, _PRESS, _REST = 0.05, 0.45, 0.3
_SHIFTED, _SHIFT, _DEAD, _NOISY, _NOISIER = 5, 0.15, 17, 26, 3.0
_WIDTH_TAXELS: Final = 1.3
#: Words of each kind and part.
_CASES: Final = 6


class _Sample(NamedTuple):
    """Counts of all taxels, and what happens on the bus."""

    counts: npt.NDArray[np.uint16]
    bus: str
    is_asked: bool


def stepped_vectors_text(contract: Contract, node: NodeContract) -> str:
    """Return the test vectors of a stepped board as JSON."""
    random = np.random.default_rng(node.block)
    idle = [_read(contract, np.zeros(contract.phi.block_size), random) for _ in range(IDLE_SAMPLES + SETTLING_SAMPLES)]
    board = _Board(contract, node, idle)
    return json_text(
        {
            "bus": contract.layout.bus[node.bus].name,
            "node_id": node.node_id,
            "signatures": [_signed(contract, node, *values) for values in ((1.0, 0), (0.5, -3))],
            "tables": _tables(),
            "words": [case for form in dict.fromkeys(node.forms) for case in _words(form, random)],
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
    """Return the numbers of the filter that are not in the documents, binary32."""
    models = make_models(HORIZON)
    return {
        **{name: _reals(values) for name, values in models._asdict().items()},
        "power": _reals(POWER),
        "unclip": _reals(unclip_table()),
    }


def _reals(values: Iterable[Any]) -> list[float]:
    """Return binary32 numbers in as few digits as tell them apart."""
    return [float(f"{value:.9g}") for value in values]


# --- words ----------------------------------------------------------------------------------------------------


def _words(form: Form, random: np.random.Generator) -> Iterator[dict[str, object]]:
    """Yield words of a part, each with what it says, the integers before, and those after."""
    bounds = np.array([limits(place, form) for place in range(form.sums)]).T
    for number in range(_CASES):
        known: Integers = random.integers(bounds[0], bounds[1], endpoint=True)
        sent, slot, half = int(random.integers(COUNT)), int(random.integers(SLOTS)), form.radix // 2
        scale, group = int(random.integers(len(SCALES))), int(random.integers(form.groups))
        if number == 0:  # the largest word
            sent, slot, scale, group, known = COUNT - 1, SLOTS - 1, len(SCALES) - 1, form.groups - 1, bounds[1].copy()
        digits = np.full(form.sums, half) if number == 0 else random.integers(-half, half, form.sums, endpoint=True)
        moved = known + SCALES[scale] * digits
        about = {"sums": form.sums, "has_first": bool(form.has_first), "sent": sent, "slot": slot}
        word = step_word(digits, scale, sent, form)
        yield about | {"kind": "step", "scale": SCALES[scale], "known": known.tolist()} | _coded(word, moved)
        word = set_word(group, known, sent, slot, form)
        yield about | {"kind": "set", "group": group, "known": [0] * form.sums} | _coded(word, _only(group, known))
        yield about | {"kind": "check", "known": known.tolist()} | _coded(check_word(known, sent, slot, form), known)


def _only(group: int, known: Integers) -> Integers:
    """Return the integers of a group, and 0 for all others."""
    return np.where(np.arange(len(known)) // SET_SUMS == group, known, 0)


def _coded(word: int, known: Integers) -> dict[str, object]:
    payload = np.zeros(WORD_BYTES, np.uint8)
    write_word(word, payload)
    return {"word": payload.tobytes().hex(), "then_known": known.tolist()}


# --- samples --------------------------------------------------------------------------------------------------


def _samples(contract: Contract, random: np.random.Generator) -> Iterator[_Sample]:
    """Yield a touch that comes, slides over the patch, rests and goes."""
    high, wide = patch_shape(contract.phi.block_size)
    row, column = np.indices((high, wide)).reshape(2, -1)
    for now in range(SAMPLES):
        slid = min(1.0, max(0, now - _PRESSED) / (_STOPPED - _PRESSED))
        away = np.square(row - 0.5 - (high - 2.5) * slid) + np.square(column - 1 - (wide - 3) * slid)
        press = min(1.0, max(0, now - _PRESSED) / 6) * (_PRESS if now < _STOPPED + 20 else _REST)
        press *= min(1.0, max(0, _RELEASED + 5 - now) / 5)
        counts = _read(contract, press * np.exp(-away / _WIDTH_TAXELS**2), random)
        bus = "lost" if now in _LOST else "held" if now in _HELD else "free"
        yield _Sample(counts, bus, now == _REQUESTED)


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
        self._node, self._newton_per_count = node, contract.layout.taxels.newton_per_count
        statistics = IdleStatistics(1, contract.phi.block_size)
        for counts in idle[:IDLE_SAMPLES]:
            statistics.take(self._newtons(counts))
        self._learned: Noise = statistics.noise()
        self._filter = PatchFilter(self._learned, contract.phi.held[[node.block]])
        for counts in idle[IDLE_SAMPLES:]:
            self._filter.take(self._newtons(counts))
        self._senders = Senders(contract)
        self._senders.set_cob_ids(node.block, [tpdo.cob_id for tpdo in node.tpdos])
        self._senders.set_operational(node.block, True)
        self._period = round(contract.layout.sync.period_s * 1e9) // SAMPLE_NS
        self._now = 0
        self._held = frames(0)

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
        if sample.is_asked:
            self._senders.ask(self._node.block)
        number, since = divmod(self._now, self._period)
        now_ns = self._now * SAMPLE_NS + SINCE_SYNC_NS
        counter = (_FIRST_COUNTER + number - 1) % SYNC_OVERFLOW + 1
        if since == 0:
            self._senders.take_sync(self._node.bus, counter, self._now * SAMPLE_NS)
        self._now += 1
        self._filter.take(self._newtons(sample.counts))
        known = self._filter.sums_n, self._filter.variance_n2, self._filter.noise.node_n
        burst, _ = self._senders.take_slots(now_ns, *known)
        self._held = np.concatenate([self._held, burst])
        if sample.bus != "held":
            self._held["flags"] |= ECHO if sample.bus == "free" else ECHO | ERROR
            self._senders.take_echoes(self._node.bus, self._held)
            self._held = self._held[:0]
        return {
            "sync": counter if since == 0 else 0,
            "is_asked": sample.is_asked,
            "bus": sample.bus,
            "counts": sample.counts.tolist(),
            "sums_n": _reals(self._filter.sums_n[0]),
            "variance_n2": _reals(self._filter.variance_n2[0]),
            "frames": [
                {"cob_id": int(each["can_id"]), "data": each["data"][: each["length"]].tobytes().hex()}
                for each in burst
            ],
        }


def _noise(noise: Noise) -> dict[str, object]:
    """Return the noise of the first board."""
    return {
        "taxel_noise_n": _reals(noise.taxel_n[0]),
        "coefficient_noise_n": _reals(noise.coefficient_n[0]),
        "board_noise_n": float(noise.node_n[0]),
    }
