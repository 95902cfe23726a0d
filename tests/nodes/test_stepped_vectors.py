"""The test vectors for stepped firmware are what a virtual board and a receiver make of the same samples."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, frames
from dbc.steps import CHECK, SET, SLOTS, STEP, kind_of
from nodes.segment import Segment
from nodes.sending import vector_files
from nodes.steps import patch_boards
from nodes.steps.boards import SteppedBoards
from nodes.steps.noise import IdleStatistics
from nodes.virtual_boards import VirtualBoards
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.nodes.helpers import ArrayLink, Still
from tests.nodes.stepped_bus import Part

pytestmark = pytest.mark.heavy

BUSES = ["steps", "steps-fd"]


@cache
def vectors_of(name: str) -> tuple[Contract, dict[str, Any]]:
    contract = Contract.from_layout(load_layout(Path(name)))
    ((path, text),) = vector_files(contract).items()
    assert path == "vectors/bus0-001.json"
    return contract, json.loads(text)


class Played:
    """The sensors of one board, which read given counts, sample by sample."""

    def __init__(self, newton_per_count: float, counts: list[list[int]]) -> None:
        self.counts, self.shows_pattern = np.zeros((1, 32), np.float32), np.zeros(1, np.bool_)
        self.touch_from_ns: int | None = None
        self._npc, self._left = np.float32(newton_per_count), iter(counts)

    def sample(self, _: int) -> npt.NDArray[np.float32]:
        self.counts[0] = next(self._left)
        return self.counts * self._npc


@pytest.mark.parametrize("name", BUSES)
def test_a_virtual_board_sends_the_frames_of_the_vectors(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    contract, vectors = vectors_of(name)
    samples = vectors["samples"]
    counts = vectors["power_up"]["counts"] + [each["counts"] for each in samples]
    played = Played(contract.layout.taxels.newton_per_count, counts)
    monkeypatch.setattr(patch_boards, "PatchSensors", lambda *_: played)
    boards = SteppedBoards(contract, [0], Still(contract))
    monkeypatch.setattr(boards, "touched_from", lambda _: None)  # what is touched is played
    settled = vectors["power_up"]["settled"]
    for index, key in ((0x2033, "taxel_noise_n"), (0x2032, "coefficient_noise_n")):
        learned = [boards.read(0, index, place) for place in range(1, 33)]
        assert learned == np.float32(settled[key]).tolist()
    assert boards.read(0, 0x2035, 0) == settled["board_noise_n"]
    assert np.array_equal(boards.filter.sums_n[0], np.float32(settled["sums_n"]))
    link = ArrayLink()
    nodes = VirtualBoards(contract, 0, {1}, boards)
    segment = Segment(contract, 0, nodes, boards, link.send, complain=lambda _: None)
    now_s = 100.0
    segment.boot(now_s)
    segment.take(frame(0, b"\x01\x01"), now_s)
    waiting, kinds, form = frames(0), [], contract.forms_of(0)[0]
    for number, sample in enumerate(samples):
        if sample["is_asked"]:
            segment.take(frame(0x601, bytes((0x2F, 0x30, 0x20, 0, 1, 0, 0, 0))), now_s)
        if sample["sync"]:
            segment.take(frame(0x80, bytes((sample["sync"],)), time_ns=round((now_s - 0.5e-3) * 1e9)), now_s)
        link.take_sent()
        segment.tick(now_s)
        burst = link.take_sent()
        burst = burst[burst["can_id"] < 0x580]
        found = [
            {"cob_id": int(each["can_id"]), "data": each["data"][: each["length"]].tobytes().hex()} for each in burst
        ]
        assert found == sample["frames"], number
        assert np.array_equal(boards.filter.sums_n[0], np.float32(sample["sums_n"]))
        assert np.array_equal(boards.filter.variance_n2[0], np.float32(sample["variance_n2"]))
        waiting = np.concatenate([waiting, burst])
        if sample["bus"] != "held":
            waiting["flags"] |= ECHO | ERROR if sample["bus"] == "lost" else ECHO
            segment.take(waiting, now_s)
            waiting = frames(0)
        kinds += [kind_of(int.from_bytes(bytes.fromhex(each["data"])[1:8], "little"), form)[0] for each in found]
        now_s += 1e-3
    assert set(kinds) == {STEP, SET, CHECK}
    assert len(kinds) > 0.4e-3 * len(vectors["samples"]) / contract.layout.steps.slot_s


@pytest.mark.parametrize("name", BUSES)
def test_what_a_board_learns_is_told_as_of_its_first_2000_samples(name: str) -> None:
    contract, vectors = vectors_of(name)
    power_up, npc = vectors["power_up"], np.float32(contract.layout.taxels.newton_per_count)
    idle = np.array(power_up["counts"])
    assert (vectors["bus"], vectors["node_id"]) == ("bus0", 1)
    assert idle.shape == (2300, 32)
    statistics = IdleStatistics(1, 32)
    for counts in idle[:2000]:
        statistics.take(counts[None].astype(np.float32) * npc)
    noise = statistics.noise()
    assert power_up["offset_n"] == pytest.approx(noise.offset_n[0].tolist(), rel=1e-8)
    assert power_up["learned"]["taxel_noise_n"] == pytest.approx(noise.taxel_n[0].tolist(), rel=1e-8)
    assert power_up["learned"]["coefficient_noise_n"] == pytest.approx(noise.coefficient_n[0].tolist(), rel=1e-8)
    assert power_up["learned"]["board_noise_n"] == noise.node_n[0]
    assert np.flatnonzero(np.array(power_up["offset_n"]) > 1e-3).tolist() == [5]


@pytest.mark.parametrize("name", BUSES)
def test_what_happens_is_what_the_guide_to_the_firmware_says(name: str) -> None:
    _, vectors = vectors_of(name)
    samples = vectors["samples"]
    assert len(samples) == 1000
    of_bus = {bus: [at for at, each in enumerate(samples) if each["bus"] == bus] for bus in ("lost", "held", "free")}
    assert of_bus["lost"] == list(range(200, 240))
    assert of_bus["held"] == list(range(430, 500))
    assert len(of_bus["free"]) == 1000 - 40 - 70
    assert [number for number, each in enumerate(samples) if each["is_asked"]] == [300]
    syncs = {number: each["sync"] for number, each in enumerate(samples) if each["sync"]}
    assert syncs == {100 * each: counter for each, counter in enumerate((*range(236, 241), *range(1, 6)))}
    counts = np.array([each["counts"] for each in samples])
    assert counts.max() <= 1023
    assert counts.min() == 0
    assert not counts[:, 17].any()
    # The noise is a twentieth of 1023 counts, clipped at 0; taxel 5 is shifted by 0.15 of them.
    idle = np.array(vectors["power_up"]["counts"])
    clipped = 0.05 * 1023 * (0.5 - 0.5 / np.pi) ** 0.5
    deviation = idle.std(axis=0)
    others = np.delete(deviation, [5, 17, 26])
    assert others == pytest.approx(np.full(29, clipped), rel=0.08)
    assert deviation[26] == pytest.approx(3 * clipped, rel=0.08)
    assert idle.mean(axis=0)[5] == pytest.approx(0.15 * 1023, rel=0.03)


@pytest.mark.parametrize("name", BUSES)
def test_words_say_what_a_receiver_makes_of_them(name: str) -> None:
    contract, vectors = vectors_of(name)
    forms = {(form.sums, bool(form.has_first)): form for form in contract.forms_of(0)}
    assert len(vectors["words"]) == 18 * len(forms)
    for case in vectors["words"]:
        part = Part(forms[case["sums"], case["has_first"]], SLOTS)
        part.known[:] = case["known"]
        # The word before came in the slot before.
        part.sent, part.slot, part._is_chained, part.missing = case["sent"] - 1, case["slot"] - 1, True, set()
        part.take(case["slot"] % 240 + 1, int.from_bytes(bytes.fromhex(case["word"]), "little"), case["slot"])
        assert part.kinds == [{"step": STEP, "set": SET, "check": CHECK}[case["kind"]]]
        assert (part.gaps, part.different, part.sent, part.slot) == (0, 0, case["sent"], case["slot"])
        assert part.known.tolist() == case["then_known"]


@pytest.mark.parametrize("name", BUSES)
def test_numbers_of_the_filter_are_told(name: str) -> None:
    _, vectors = vectors_of(name)
    tables = vectors["tables"]
    assert {key: len(values) for key, values in tables.items()} == {
        "gain": 8,
        "slope_gain": 8,
        "half_precision": 8,
        "log_spread": 8,
        "variance": 8,
        "power": 6,
        "unclip": 1024,
    }
    # Averages with gains 2^-k, then g-h filters with memories 1 - 2^-k (docs/steps.md).
    memory = 1 - 2.0 ** -np.arange(2, 7)
    assert tables["gain"] == pytest.approx([1, 2**-6, 2**-8, *(1 - memory**2)])
    assert tables["slope_gain"] == pytest.approx([0, 0, 0, *((1 - memory) ** 2)])
    x = np.linspace(0, 1, 7)
    assert np.polyval(tables["power"][::-1], x) == pytest.approx(2**x, rel=3e-7)
    assert tables["unclip"][-1] == pytest.approx(6, abs=1e-4)  # where clipping has no effect any more
