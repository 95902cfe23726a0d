"""The test vectors for adaptive firmware are what a virtual board and a receiver make of the same samples."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dbc.adaptive import NODES, cob_id
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR
from gateway.adaptive_state import new_sums, take
from nodes.adaptive import patch_boards
from nodes.adaptive.boards import AdaptiveBoards
from nodes.adaptive.noise import IdleStatistics
from nodes.segment import Segment
from nodes.virtual_boards import VirtualBoards
from nodes.ways import vector_files
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.nodes.helpers import ArrayLink, Still

pytestmark = pytest.mark.heavy

BUSES = ["adaptive", "adaptive-fd"]


@cache
def vectors_of(name: str) -> tuple[Contract, dict[str, Any]]:
    contract = Contract.from_layout(load_layout(Path(name)))
    ((path, text),) = vector_files(contract).items()
    assert path == "vectors/bus0-001.json"
    return contract, json.loads(text)


class Played:
    """The sensors of one board, which read given counts, sample by sample."""

    def __init__(self, newton_per_count: float, counts: list[list[int]]) -> None:
        self.counts = np.zeros((1, 32), np.float32)
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
    boards = AdaptiveBoards(contract, [0], Still(contract))
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
    sent = 0
    for number, sample in enumerate(samples):
        if sample["request"]:
            segment.take(frame(0x601, bytes((0x2F, 0x30, 0x20, 0, sample["request"], 0, 0, 0))), now_s)
        link.take_sent()
        segment.tick(now_s)
        burst = link.take_sent()
        burst = burst[burst["can_id"] < 0x580]
        found = [
            {"cob_id": int(each["can_id"]), "data": each["data"][: each["length"]].tobytes().hex()} for each in burst
        ]
        assert found == sample["frames"], number
        assert np.array_equal(boards.filter.sums_n[0], np.float32(sample["sums_n"]))
        variances_n2 = np.float64(boards.filter.variance_n2[0]).reshape(4, 8).sum(axis=1)
        assert sample["variance_n2"] == pytest.approx(variances_n2.tolist())
        burst["flags"] |= ECHO | ERROR if sample["is_busy"] else ECHO
        segment.take(burst, now_s)
        sent += len(burst) * (not sample["is_busy"])
        now_s += 1e-3
    assert sent > 50


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
    busy = [number for number, each in enumerate(samples) if each["is_busy"]]
    assert busy == [*range(200, 240), *range(560, 870)]
    assert {number: each["request"] for number, each in enumerate(samples) if each["request"]} == {300: 0b0101}
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
def test_the_touch_slides_over_the_patch_rests_and_goes(name: str) -> None:
    """A round force of width 1.3 taxels; of the full scale 0.45 while it comes and slides, 0.3 while it rests."""
    _, vectors = vectors_of(name)
    counts = np.array([each["counts"] for each in vectors["samples"]], np.float64)
    high, wide = 4, 8
    row, column = np.indices((high, wide)).reshape(2, 32)
    good = np.delete(np.arange(32), [5, 17, 26])

    def touch(away: float, part: float) -> npt.NDArray[np.float64]:
        square = (row - 0.5 - 1.5 * away) ** 2 + (column - 1 - 5 * away) ** 2
        return np.asarray(part * 1023 * np.exp(-square / 1.69), np.float64)

    def error(first: int, last: int, expected: npt.NDArray[np.float64]) -> float:
        strong = good[expected[good] > 150]  # where clipping at 0 is rare
        return float(np.abs(counts[first:last].mean(axis=0) - expected)[strong].max())

    assert counts[:121, good].max() < 300  # noise alone
    assert error(126, 130, touch(8 / 280, 0.45)) < 80
    assert error(255, 265, touch(0.5, 0.45)) < 60
    assert error(400, 420, touch(1, 0.45)) < 45
    assert error(421, 900, touch(1, 0.3)) < 15
    # It comes in 6 ms and goes in 5: what part of it shows, taxels weighed by their force.
    for first, expected, where, part in (
        (120, [0, 1 / 6, 2 / 6, 3 / 6, 4 / 6, 5 / 6, 1, 1], 4 / 280, 0.45),
        (898, [1, 1, 1, 0.8, 0.6, 0.4, 0.2, 0, 0], 1, 0.3),
    ):
        shape = touch(where, part)[good]
        shown = counts[first : first + len(expected), good] @ shape / (shape @ shape)
        assert shown == pytest.approx(expected, abs=0.3)
        assert shown.sum() == pytest.approx(sum(expected), abs=0.35)
    assert counts[905:, good].mean() < 0.4 * 0.05 * 1023 * 1.1


@pytest.mark.parametrize("name", BUSES)
def test_codes_stand_for_what_a_receiver_of_the_frames_shows(name: str) -> None:
    contract, vectors = vectors_of(name)
    law, cases = contract.law, vectors["codes"]
    assert [case["name"] for case in cases] == ["nothing", "the largest sums", *[f"random {n}" for n in range(1, 9)]]
    for case in cases:
        receiver = new_sums(NODES)
        for kind, values in (("coarse", "coarse_values_n"), ("fine", "fine_values_n")):
            for group in range(4):
                identifier = cob_id(0, 0, group, kind == "fine")
                data = np.frombuffer(bytes.fromhex(case[kind][group]), np.uint8)
                take(identifier, 8, data, 0, law, receiver, False)
            assert receiver.value_n[0].tolist() == case[values]
        fine = np.abs(np.array(case["fine_values_n"]) - case["later_sums_n"])
        assert fine.max() <= 0.501 * law.fine_n


def test_cases_of_codes_reach_from_nothing_to_the_largest_sums() -> None:
    contract, vectors = vectors_of("adaptive")
    nothing, largest, *others = vectors["codes"]
    assert nothing["sums_n"] == nothing["later_sums_n"] == [0.0] * 32
    assert nothing["coarse_values_n"] == nothing["fine_values_n"] == [0.0] * 32
    # All 32 taxels at 0.02 N; a difference of two halves is half as large.
    assert largest["sums_n"] == pytest.approx([0.64] + [-0.32] * 31)
    assert largest["later_sums_n"] == largest["sums_n"]
    sums_n = np.array([case["sums_n"] for case in others])
    size_n = np.abs(sums_n)
    assert (sums_n[:, 0] > 0).all()
    assert size_n[:, 0].max() <= 0.64
    assert size_n[:, 1:].max() <= 0.32
    assert size_n.min() >= 1e-5
    assert size_n[:, 1:].max() > 0.2
    assert size_n.min() < 1.5e-5
    assert 0.3 < (sums_n[:, 1:] < 0).mean() < 0.7
    assert np.abs(np.log10(size_n[:, 1:]).mean() - np.log10(1e-5 * 0.32) / 2) < 0.2
    later = np.array([case["later_sums_n"] for case in others]) - [case["coarse_values_n"] for case in others]
    steps = later / contract.law.fine_n
    # A fine frame reaches 62 steps to each side.
    assert -61 <= round(steps.min(), 3) < -55
    assert 55 < round(steps.max(), 3) <= 61
    assert len(np.unique(sums_n)) == sums_n.size


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
        "log2": 9,
    }
    # Averages with gains 2^-k, then g-h filters with memories 1 - 2^-k (docs/adaptive.md).
    memory = 1 - 2.0 ** -np.arange(2, 7)
    assert tables["gain"] == pytest.approx([1, 2**-6, 2**-8, *(1 - memory**2)])
    assert tables["slope_gain"] == pytest.approx([0, 0, 0, *((1 - memory) ** 2)])
    assert tables["log2"] == pytest.approx([2 / np.log(2) / odd for odd in range(1, 18, 2)])
    x = np.linspace(0, 1, 7)
    assert np.polyval(tables["power"][::-1], x) == pytest.approx(2**x, rel=3e-7)
    assert tables["unclip"][-1] == pytest.approx(6, abs=1e-4)  # where clipping has no effect any more
