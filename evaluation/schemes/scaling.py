"""``skin evaluate scaling``: how buses, times, memory and quality grow with the taxels, at one sum for four taxels."""

import gc
import math
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from functools import partial
from types import FunctionType, ModuleType
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
import numpy.typing as npt

from classifier.decide import Classifier
from classifier.model import Model
from classifier.newest_sums import FORGET_CYCLES
from classifier.samples import simulate_sums
from classifier.training import TrainingOptions, train
from dbc.contract import Contract, sync_frame
from dbc.frame import ECHO, Frames
from dbc.frame_bits import wire_bits
from demo.chain import REST_S, Nodes
from evaluation.result import Options, Picture, Result, Row, new_figure
from evaluation.result_cache import measure_cells
from evaluation.schemes.sums import burst
from gateway.collector import Collector, Gathered
from reconstructor.imaging import CycleImager
from skin.layout import Layout, parse_layout
from skin.measured_sums import decode_measurement
from skin.psnr import psnr_db
from skin.sources import Frame, load_touches
from skin.taxel import NOISE_N
from touch.contact import Force, Grid
from touch.sources import ObjectSource
from touch.strokes import PAUSE_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Made = TypeVar("Made")
#: Taxels along a side of the square skins; 256 is the most that a layout takes.
SIDES: Final = (32, 64, 128, 256)
#: Side of a skin that is computed from the largest of them, not run.
COMPUTED_SIDE: Final = 1024
#: Side of a part, taxels. An object touches each part, so that the same ratio of all skins is touched.
TILE: Final = 32
TOUCHING: Final = "golf-ball"
#: Objects that are to be recognised, anywhere on the skin.
OBJECTS: Final = ("golf-ball", "racquetball", "gravy-can", "jello-box")
#: Cycles with touch that are measured.
CYCLES, QUICK_CYCLES = 120, 20
#: Touches of each object for training and for the test, and draws of the untouched skin.
TOUCHES, QUICK_TOUCHES = 100, 20
UNTOUCHED, QUICK_UNTOUCHED = 500, 50
#: Times are this quantile over the cycles: others use the machine, too.
FAST: Final = 0.1
#: What is timed, by the name of its column: all boards of the simulated skin, the gateway's collector, one image, one
#: label.
TIMED: Final = ("sample_ms", "collect_ms", "image_ms", "label_ms")
#: Exponent at least with which a time or a memory is computed, 1 without: the classifier multiplies images of n taxels
#: by matrices of √n rows, which up to the largest skin costs less than the rest of a label.
LEAST_GROWTH: Final = {"label_ms": 1.5}
GROWING: Final = (*TIMED, "solver_mb", "classifier_mb")


def evaluate(options: Options) -> Result:
    """Return a row for each skin, from a run of its boards, frames, gateway, solver and classifier in one process."""
    sides = SIDES[:2] if options.quick else SIDES
    asked: Row = {
        "cycles": QUICK_CYCLES if options.quick else CYCLES,
        "touches": QUICK_TOUCHES if options.quick else TOUCHES,
        "untouched": QUICK_UNTOUCHED if options.quick else UNTOUCHED,
        "seed": options.seed,
    }
    cells = [{"side": side, **asked} for side in sides]
    rows = measure_cells(measure, cells, options, "skins", jobs=1)
    rows.append(_computed(rows[-2], rows[-1]))
    for before, row in zip([None, *rows], rows, strict=False):
        for name in GROWING:
            row[f"{name.rsplit('_', 1)[0]}_growth"] = None if before is None else round(_growth(name, before, row), 2)
    return Result("Skins of 1,024 taxels and more, one sum for four taxels, 100 Hz", rows, _pictures(rows), _NOTE)


def measure(*, side: int, cycles: int, touches: int, untouched: int, seed: int) -> Row:
    """Return the figures of a square skin of `side` x `side` taxels, one board for 32 taxels, 32 boards on a bus."""
    layout = skin_of(side)
    contract = Contract.from_layout(layout)
    model = _trained(layout, touches, untouched, seed)
    nodes, imager = Nodes(layout, _Tiles(side, seed), seed=seed), CycleImager(layout)
    phi = layout.phi()
    classifier = Classifier(model, phi)
    buses = _Buses(contract)
    begin = round((REST_S + PAUSE_S) * layout.sync.rate_hz)
    times_s = defaultdict[str, list[float]](list)
    psnrs_db, sensed_db, bits = list[float](), list[float](), list[int]()
    for number in range(1, begin + cycles + 1):
        sample_s, counts = _timed(nodes.sample)
        truth, on_wire = nodes.truth(), buses.frames(counts, nodes.counter)
        collect_s, gathered = _timed(partial(buses.collected, on_wire, nodes.counter))
        if not gathered.complete or not np.array_equal(gathered.sums, counts):
            raise RuntimeError("the collector lost sums of a simulated cycle")
        sums = decode_measurement(nodes.measurement(gathered.sums), phi)
        image_s, (image_n, _) = _timed(partial(imager.solve, sums))
        label_s, _ = _timed(partial(classifier.decide, sums.counts, sums.valid, number))
        if number <= begin:
            continue
        for name, spent_s in zip(TIMED, (sample_s, collect_s, image_s, label_s), strict=True):
            times_s[name].append(spent_s)
        bits.append(sum(int(wire_bits(each)[0].sum()) for each in on_wire))
        true_n, sensor_n = (np.frombuffer(each, "<f4").reshape(side, side) for each in (truth.true, truth.sensor))
        if true_n.any():
            psnrs_db.append(psnr_db(true_n, image_n))
            sensed_db.append(psnr_db(true_n, sensor_n))
    return {
        "taxels": layout.taxels.count,
        "from": "run",
        "sums": layout.measurement.sums,
        "buses": len(layout.bus),
        "nodes": len(contract.nodes),
        "mbit_per_s": round(float(np.mean(bits)) * layout.sync.rate_hz * 1e-6, 2),
        "sensor_db": round(float(np.mean(sensed_db)), 2),
        "psnr_db": round(float(np.mean(psnrs_db)), 2),
        "right_percent": round(100 * _right_ratio(model, layout, touches, seed), 1),
        **{name: round(1e3 * float(np.quantile(times_s[name], FAST)), 4) for name in TIMED},
        "solver_mb": round(held_bytes(imager.solver) * 1e-6, 3),
        "classifier_mb": round(held_bytes(classifier) * 1e-6, 3),
    }


def skin_of(side: int) -> Layout:
    """Return the layout of a square skin with the default skin's rates, on as many buses as it needs."""
    text = f"[taxels]\nrows = {side}\ncolumns = {side}\n[sync]\nrate_hz = 100.0\n[sampling]\nrate_hz = 1000.0\n"
    return parse_layout(text.encode(), f"{side} x {side}")


class _Tiles:
    """A touch of `TOUCHING` on each tile of a square skin; a `skin.sources.TaxelSource`."""

    has_noise = False

    def __init__(self, side: int, seed: int) -> None:
        self._across = side // TILE
        grid = Grid(TILE, TILE)
        self._tiles = [
            ObjectSource(grid, 100.0, [TOUCHING], seed + tile, rest_s=REST_S) for tile in range(self._across**2)
        ]

    def frame(self, step: int) -> Frame:
        """Return the touch at `step`."""
        tiles: Force = np.stack([tile.frame(step).force_n for tile in self._tiles])
        rows = tiles.reshape(self._across, self._across, TILE, TILE).swapaxes(1, 2)
        return Frame(np.ascontiguousarray(rows.reshape(self._across * TILE, -1)), "")


class _Buses:
    """The frames of each cycle, and the gateway's collector of them."""

    def __init__(self, contract: Contract) -> None:
        self._contract = contract
        self._collector = Collector(contract)
        self._collector.trust(slice(None), proven=True)
        self._rows = [np.flatnonzero(contract.table.bus == bus) for bus in range(len(contract.layout.bus))]

    def frames(self, counts: npt.NDArray[np.int32], counter: int) -> list[Frames]:
        """Return the SYNC of each bus and the TPDOs that answer it."""
        echo = sync_frame(counter)
        echo["flags"] |= ECHO
        return [np.concatenate([echo, burst(self._contract, counts, rows, counter)]) for rows in self._rows]

    def collected(self, on_wire: Sequence[Frames], counter: int) -> Gathered:
        """Return what the collector makes of a cycle."""
        self._collector.open(counter)
        for bus, each in enumerate(on_wire):
            self._collector.take(bus, each, 0)
        return self._collector.close(counter)


def _timed(call: Callable[[], Made]) -> tuple[float, Made]:
    """Return the processor time of a call, and its result."""
    started_s = time.thread_time()
    result = call()
    return time.thread_time() - started_s, result


def _trained(layout: Layout, touches: int, untouched: int, seed: int) -> Model:
    force_n, labels = load_touches(OBJECTS, touches * len(OBJECTS), layout, seed=seed)
    return train(force_n, labels, layout, options=TrainingOptions(no_touches=untouched, seed=seed))


def _right_ratio(model: Model, layout: Layout, touches: int, seed: int) -> float:
    """Return how often single cycles of other touches, anywhere on the skin, get the right label."""
    phi = layout.phi()
    force_n, labels = load_touches(OBJECTS, touches * len(OBJECTS), layout, seed=seed + 1)
    sums = simulate_sums(force_n, layout, phi, NOISE_N, np.random.default_rng(seed + 1))
    classifier = Classifier(model, phi, settling=1.0)
    valid = np.ones(phi.blocks, np.bool_)
    # Each touch begins anew, because the cycles between two touches are missing.
    apart = FORGET_CYCLES + 1
    said = [classifier.decide(each, valid, apart * turn).label for turn, each in enumerate(sums, 1)]
    return float(np.mean(np.array(said) == labels))


def held_bytes(thing: object) -> int:
    """Return the bytes of all arrays that an object holds, without those of the code that it calls."""
    seen: set[int] = set()
    total, waiting = 0, [thing]
    while waiting:
        each = waiting.pop()
        # A compiled function holds its compiler, and this holds arrays of whatever else was compiled.
        is_code = isinstance(each, type | ModuleType | FunctionType) or type(each).__module__.startswith("numba")
        if is_code or id(each) in seen:
            continue
        seen.add(id(each))
        if not isinstance(each, np.ndarray):
            waiting += gc.get_referents(each)
        elif each.base is None:
            total += each.nbytes
        else:
            waiting.append(each.base)
    return total


def _growth(name: str, before: Row, row: Row) -> float:
    return math.log(row[name] / before[name]) / math.log(row["taxels"] / before["taxels"])


def _computed(before: Row, last: Row) -> Row:
    """Return the row of `COMPUTED_SIDE`: counts in proportion, times and memory with the growth of the last skin."""
    taxels = COMPUTED_SIDE**2
    ratio = taxels / last["taxels"]
    row = last | {"taxels": taxels, "from": "arithmetic"} | dict.fromkeys(("sensor_db", "psnr_db", "right_percent"))
    row |= {name: round(last[name] * ratio) for name in ("sums", "buses", "nodes", "mbit_per_s")}
    for name in GROWING:
        row[name] = round(last[name] * ratio ** max(LEAST_GROWTH.get(name, 1.0), _growth(name, before, last)), 3)
    return row


_NOTE: Final = (
    "sample_ms: all simulated boards; collect_ms: the gateway's collector; image_ms: one image; label_ms: one label; "
    "processor time, fastest tenth of the cycles. solver_mb, classifier_mb: arrays. ..._growth: exponent of the taxels "
    "from the row before; n log n has 1.1. right_percent: single cycles, four objects, anywhere. From arithmetic: "
    "counts in proportion, times and memory with the last exponent, 1 at least, 1.5 for a label."
)


def _pictures(rows: Sequence[Row]) -> list[Picture]:
    caption = "Time of each step, and memory, over the taxels; the last point is from arithmetic. Dotted: n log n."
    return [Picture(caption, lambda: _draw(rows))]


def _draw(rows: Sequence[Row]) -> "Figure":
    figure = new_figure(10, 4.2)
    times, memory = figure.subplots(1, 2)
    taxels = np.array([row["taxels"] for row in rows], np.float64)
    for axes, names, unit in ((times, TIMED, "ms"), (memory, ("solver_mb", "classifier_mb"), "MB")):
        for name in names:
            values = [row[name] for row in rows]
            (line,) = axes.plot(taxels[:-1], values[:-1], marker="o", label=name.rsplit("_", 1)[0])
            axes.plot(taxels[-2:], values[-2:], marker="x", linestyle="--", color=line.get_color())
            steps = taxels * np.log2(taxels)
            axes.plot(taxels, values[0] * steps / steps[0], linestyle=":", linewidth=0.8, color=line.get_color())
        axes.set(xscale="log", yscale="log", xlabel="taxels", ylabel=unit)
        axes.grid(alpha=0.3)
        axes.legend()
    return figure
