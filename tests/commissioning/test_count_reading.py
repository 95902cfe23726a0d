"""The counts of all boards are read by SDO while a finger goes over the skin: `skin node check --live`."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canskin.errors import InputError, RunError
from commissioning.count_reading import CountReading
from commissioning.node_check_command import check
from commissioning.node_options import NodeOptions
from commissioning.wiring_check import check_counts, finger_path
from commissioning.wiring_findings import Finding
from dbc.configuration import DIALOGUES
from dbc.contract import Contract
from dbc.frame import EXTENDED
from nodes.hardware import Hardware
from nodes.sending import sending_of
from skin.defects import Defects
from skin.layout import Layout
from skin.surface import Floats
from tests.bus.harness import frame
from tests.commissioning.wiring_errors import REST, Finger, pressed, stroke
from tests.layouts import STEPPED, buses, layout_toml, small_layout
from tests.world import Skin

STEP_S = 0.005


class Stroked(Skin):
    """All boards of a skin, a finger that goes over it, and who reads their counts."""

    step_s = STEP_S

    def __init__(self, layout: Layout, path_m: Floats, force_n: Any, **defects: float) -> None:
        self.path_m, self._source, self._defects = path_m, Finger(layout, path_m, force_n), defects
        #: When the first SYNC was sent, and where the finger was, by time.
        self.begin_s = 0.0
        self.places: list[tuple[float, ...]] = []
        self.said: list[str] = []
        super().__init__(Contract.from_layout(layout), now_s=10.0)

    def new_hardware(self) -> Hardware:
        contract, options = self.contract, {"noise_n": 2e-4, "seed": 1, "defects": Defects.of(self._defects, seed=3)}
        blocks = [node.block for node in contract.nodes]
        return sending_of(contract.layout).hardware(contract, blocks, self._source, None, **options)

    def read(self, stroke_s: float, until: Callable[[CountReading], object] = lambda _reading: False) -> CountReading:
        """Read the counts to the end, or stop the stroke earlier."""
        sends = {bus: wire.gateway.send for bus, wire in enumerate(self.wires)}
        reading = CountReading(self.contract, sends, self.now_s, rest_s=0.15, stroke_s=stroke_s, say=self.said.append)

        def look() -> None:
            if until(reading):
                reading.stop()
            if not self.begin_s and any(can_id == 0x080 for can_id, _ in self.wires[0].log):
                self.begin_s = self.now_s - STEP_S
            while (truth := self.hardware.take_truth()) is not None:
                place_m = self.path_m[min(truth.step, len(self.path_m) - 1)]
                self.places.append((truth.sampled_mono_ns / 1e9, *place_m))

        self.lead(reading, lambda bus, arrived: reading.take(bus, arrived, self.now_s), look)
        look()
        return reading

    def findings(self, reading: CountReading, folder: Path | None) -> list[Finding]:
        """Return what is found with the path of the finger, in a file of `folder`, or without it."""
        if folder is None:
            return check_counts(self.contract.layout, reading, None)
        lines = ["time_s,x_m,y_m,z_m"]
        lines += [",".join(map(str, (each[0] - self.begin_s, *each[1:]))) for each in self.places]
        (folder / "finger.csv").write_text("\n".join(lines), encoding="utf-8")
        return check_counts(self.contract.layout, reading, finger_path(folder / "finger.csv"))


def smooth(layout: Layout, steps: int) -> Floats:
    """Return a path to and fro along the rows, from the first to the last."""
    surface = layout.taxels.surface
    low, high = surface.positions_m.min(axis=0), surface.positions_m.max(axis=0)
    part = np.linspace(0, 1, steps)
    to_and_fro = np.abs((part * layout.taxels.rows) % 2 - 1)
    way = np.stack((to_and_fro, part, np.zeros(steps)), axis=1)
    return np.concatenate((np.zeros((REST, 3)), low + (high - low) * way))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "knows_path", "kinds"),
    [
        (("swapped", "doubled", "dead"), True, ["dead", "dead", "doubled", "swapped", "swapped"]),
        (("swapped",), False, ["swapped", "swapped"]),
    ],
)
def test_boards_that_sample_at_sync(wrong: tuple[str, ...], knows_path: bool, kinds: list[str], tmp_path: Path) -> None:
    layout = small_layout(bus=buses(1, 1))
    passes = 5 if knows_path else 7
    path_m, force_n = stroke(layout, layout.phi(), np.random.default_rng(0), passes)
    bench = Stroked(layout, path_m, force_n, **dict.fromkeys(wrong, 0.02))
    reading = bench.read(stroke_s=passes * 0.64)
    found = bench.findings(reading, tmp_path if knows_path else None)
    assert sorted(each.kind for each in found) == kinds
    assert "readings a second: now stroke all of the skin" in bench.said[0]


@pytest.mark.slow
def test_boards_with_a_clock_of_their_own(tmp_path: Path) -> None:
    layout = small_layout(**STEPPED)
    path_m = smooth(layout, 500)
    bench = Stroked(layout, path_m, pressed(layout, layout.phi(), path_m), swapped=0.02)
    found = bench.findings(bench.read(stroke_s=5.0), tmp_path)
    assert [each.kind for each in found] == ["swapped", "swapped"]


def still(**tables: Any) -> Stroked:
    """Return a skin that nothing touches."""
    layout = small_layout(**tables)
    return Stroked(layout, np.zeros((1, 3)), np.zeros((1, layout.taxels.count)))


def test_another_master_is_refused() -> None:
    bench = still()
    bench.wires[0].put(0x080, b"")
    with pytest.raises(InputError, match="bus0: another program sends SYNC: stop the gateway"):
        bench.read(stroke_s=1.0)
    assert all(can_id in (0x080, 0x701, 0x702) for can_id, _ in bench.wires[0].log)


def test_boards_have_two_milliseconds_to_read_their_taxels(small: Contract) -> None:
    sent: list[int] = []
    sends = dict.fromkeys(range(len(small.layout.bus)), lambda each: sent.append(int(each["can_id"][0])))
    reading = CountReading(small, sends, 0.0, rest_s=1.0, stroke_s=1.0, say=lambda _: None)
    asked = []
    for now_s in (0.0, 1.0, 1.0019, 1.002):
        reading.tick(now_s)
        asked.append(any(0x600 < each < 0x680 for each in sent))
    assert 0x080 in sent
    assert asked == [False, False, False, True]


def test_frames_with_identifiers_of_29_bits_are_no_sync_of_another_master(small: Contract) -> None:
    sends = dict.fromkeys(range(len(small.layout.bus)), len)
    reading = CountReading(small, sends, 0.0, rest_s=1.0, stroke_s=1.0, say=lambda _: None)
    reading.take(0, frame(0x080, b"", EXTENDED), 0.0)
    reading.tick(0.0)
    assert not reading.done


@pytest.mark.heavy
def test_a_stroke_for_which_the_readings_come_too_slowly_is_refused() -> None:
    with pytest.raises(InputError, match=r"expected --live \d+ or more: 4 readings of each taxel, .* got 1"):
        still().read(stroke_s=1.0)


def test_analogue_boards_have_no_counts(tmp_path: Path) -> None:
    (tmp_path / "palm.toml").write_text(layout_toml(taxels={"frontend": "analogue"}), encoding="utf-8")
    with pytest.raises(InputError, match="analogue boards have no counts"):
        check(of=NodeOptions(layout=tmp_path / "palm.toml"), live=9.0)


def test_a_board_that_does_not_answer_is_named() -> None:
    bench = still()
    bench.wires[0].loses = lambda _end, each: each["can_id"] == 0x582
    with pytest.raises(RunError, match="bus0, node 2: no answer to object 2012h:1"):
        bench.read(stroke_s=9.0)


@pytest.mark.heavy
def test_a_stroke_that_is_ended_and_a_skin_that_nothing_touched() -> None:
    bench = still()
    reading = bench.read(stroke_s=9.0, until=lambda reading: reading.rest)
    _, counts = reading.readings()
    assert reading.rest <= len(counts) <= reading.rest + 2
    with pytest.raises(InputError, match="nothing touched the skin"):
        bench.findings(reading, None)


@pytest.mark.heavy
def test_requests_wait_for_each_other() -> None:
    """No more boards are asked at once than a transmit queue has room for."""
    bench = still(rows=32, columns=32)
    open_now, most = set[int](), 0
    bench.read(stroke_s=1e3, until=lambda reading: reading.rest)
    for can_id, _ in bench.wires[0].log:
        if 0x600 < can_id < 0x680:
            open_now.add(can_id - 0x600)
        elif 0x580 < can_id < 0x600:
            open_now.remove(can_id - 0x580)
        most = max(most, len(open_now))
    assert most == DIALOGUES
