"""``skin evaluate calibration``: what a skin shows while its zero drifts, scene by scene, in one process.

The boards' averages are replaced by noise of their strength and memory. A cycle is a round of the default skin, all its
sums: the zero is found from means, so it does not matter that sums come in turns. Every taxel reads at least
`PEDESTAL_N` without a touch, so that a zero which falls stays within the range of the converter.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.ndimage import binary_dilation

from calibration.calibrator import Calibrator
from calibration.field import FieldFinder
from calibration.offline import measurement_of
from canskin.calibration_messages import Region
from canskin.messages import Measurement
from canskin.sums import doubtful_taxels
from evaluation.result import Options, Result, Row
from evaluation.result_cache import measure_cells
from reconstructor.imaging import CycleImager
from skin.defects import Defects, Stage, creep
from skin.layout import Layout, changed, load_layout
from skin.measured_sums import decode_measurement
from skin.zero_drift import DRIFT_N_PER_K, REST_K, Place, ZeroDrift

#: What every taxel reads at least, and the offsets above that as part of the range.
PEDESTAL_N: Final = 5e-3
OFFSET_RATIO: Final = 0.13
#: Noise of a sum of the boards' averages, and its memory.
SUM_NOISE_N: Final = 0.36e-3
NOISE_MEMORY_S: Final = 0.25
#: Cycles between two forces, and between two images.
STEP_CYCLES: Final = 5
#: A taxel without touch shows a ghost above this force, or above this part of the largest true force.
GHOST_N: Final = 1e-3
GHOST_PART: Final = 0.05
#: Taxels count as touched within `MARGIN` of a touch, and until `RELEASE_S` after it: boards average.
MARGIN: Final = 2
RELEASE_S: Final = 0.5
#: A touch is missed where less than this part of its force is felt.
MISSED_PART: Final = 0.5
#: The zero is right where no taxel is off by more.
RIGHT_N: Final = 0.3e-3
#: Amounts of the drifts, and side of the patches.
STEPS_N: Final = (-5e-3, -2e-3, 2e-3, 5e-3)
SIDES: Final = (4, 12, 20)
_BOARD: Final = 5
#: Side of the square of references in each corner, taxels; time between two temperatures of a board.
REFERENCE_SIDE: Final = 3
TEMPERATURES_S: Final = 5.0
#: Scenes that are drawn, for each that ``rivals`` draws.
DRAWN_RATIO: Final = 2

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Press:
    """A rectangle of taxels under equal force, which moves along its row.

    Attributes
    ----------
    begin_s, end_s : float
    force_n : float
        Of a taxel.
    side : int
    row, column : int
        Of its first taxel at the begin.
    speed : float
        Taxels a second, to and fro.
    """

    begin_s: float
    end_s: float
    force_n: float
    side: int = 9
    row: int = 22
    column: int = 22
    speed: float = 0.0

    def add_to(self, force_n: Floats, time_s: float) -> None:
        """Add the force at a time to that of the skin, shape (rows, columns)."""
        if not self.begin_s <= time_s < self.end_s:
            return
        span = force_n.shape[1] - self.side
        way = self.column + self.speed * (time_s - self.begin_s)
        column = round(span - abs(way % (2 * span) - span)) if self.speed else self.column
        force_n[self.row : self.row + self.side, column : column + self.side] = self.force_n


@dataclass(frozen=True)
class Scene:
    """What happens.

    Attributes
    ----------
    words : str
    seconds : float
    drifts : tuple of ZeroDrift
    presses : tuple of Press
    creep : float
        Ratio of `skin.defects.creep`.
    tares : tuple of (float, Region or None)
        Times of forced zeros, of all of the skin or of a part.
    away : tuple of float
        First and last second in which a quarter of the boards restarts.
    is_stored : bool
        The zero of the run before is known: without the drifts and presses.
    has_references : bool
        Nothing can touch the corners of the skin.
    has_thermometers : bool
        The temperature of each board explains its drift.
    """

    words: str
    seconds: float = 60.0
    drifts: tuple[ZeroDrift, ...] = ()
    presses: tuple[Press, ...] = ()
    creep: float = 0.0
    tares: tuple[tuple[float, Region | None], ...] = ()
    away: tuple[float, ...] = ()
    is_stored: bool = False
    has_references: bool = False
    has_thermometers: bool = False


class _Cycle(NamedTuple):
    """Time, true forces and true zero of the taxels, and the sums of a skin without offsets; newtons."""

    time_s: float
    truth_n: Floats
    zero_n: Floats
    ideal_sums_n: Floats


def scenes(layout: Layout, seed: int, drawn: int) -> list[Scene]:
    """Return the named scenes, and some that are drawn."""
    return [*_named(layout), *_drawn(layout, seed, drawn)]


def evaluate(options: Options) -> Result:
    """Measure the scenes.

    Parameters
    ----------
    options : Options
        `scene_seed` and `scenes` draw scenes; `quick` leaves out these and all that last longer than 100 s.
    """
    layout, scene_seed = load_layout(), options.scene_seed or 0
    drawn = 0 if options.quick else DRAWN_RATIO * options.scenes
    found = scenes(layout, scene_seed, drawn)
    places = [place for place, scene in enumerate(found) if not options.quick or scene.seconds <= 100]
    cells: list[Row] = [
        {"place": place, "scene_seed": scene_seed, "drawn": drawn, "seed": options.seed} for place in places
    ]
    rows = measure_cells(measure_scene, cells, options, "calibration")
    return Result(
        "Zero of the default skin: scenes of drift and touch",
        [{"scene": found[place].words, **row} for place, row in zip(places, rows, strict=True)],
        note="Ghost: largest force that a taxel without touch shows, not marked as doubtful, and for how long above"
        f" {1e3 * GHOST_N:g} mN and {GHOST_PART:.0%} of the largest true force; in doubt: largest that is marked. Felt:"
        " least mean of a touch over its first and last half, part of what a skin without offsets feels; missed:"
        " touches of which less than half is felt. Away: how far an offset moves from the truth beyond what the drift"
        " had done. Right again: time from the last event until the zero is right within 0.3 mN; none: it waits for a"
        " person.",
    )


def measure_scene(place: int, scene_seed: int, drawn: int, seed: int) -> Row:
    """Return what a skin shows in the scene at `place` of `scenes`."""
    return judge_scene(scenes(load_layout(), scene_seed, drawn)[place], seed)


def judge_scene(scene: Scene, seed: int) -> Row:
    """Return what a skin shows in a scene."""
    layout = _layout_of(scene)
    judge = _Judge(layout, scene)
    calibrator = Calibrator(layout, offsets_n=judge.finder.sums(judge.rest_n) if scene.is_stored else None)
    tares, told_s = list(scene.tares), 0.0
    for number, (cycle, measurement) in enumerate(_cycles(layout, scene, judge.rest_n, seed)):
        while tares and cycle.time_s >= tares[0][0]:
            region = tares.pop(0)[1]
            calibrator.tare(force=region is None, region=region)
        if number % STEP_CYCLES == 0:
            judge.take(cycle, calibrator.apply(measurement))
        if scene.has_thermometers and cycle.time_s >= told_s + TEMPERATURES_S:
            told_s = cycle.time_s
            drift_n = (cycle.zero_n - judge.rest_n)[judge.phi.taxels_of_blocks].mean(axis=1)
            calibrator.take_temperatures(REST_K + drift_n / DRIFT_N_PER_K)
        calibrator.take(measurement)
        calibrator.work()
    return judge.row()


def _layout_of(scene: Scene) -> Layout:
    """Return the default skin, a cycle for each of its rounds, with references if the scene has some."""
    layout = load_layout()
    layout = changed(layout, sync={"rate_hz": 1 / layout.sync.round_s, "turns": 1})
    if not scene.has_references:
        return layout
    taxels = np.arange(layout.taxels.count).reshape(layout.taxels.rows, layout.taxels.columns)
    ends = np.r_[:REFERENCE_SIDE, -REFERENCE_SIDE:0]
    untouchable = tuple(taxels[np.ix_(ends, ends)].ravel().tolist())
    return changed(layout, taxels={"untouchable": untouchable})


def _cycles(layout: Layout, scene: Scene, rest_n: Floats, seed: int) -> Iterator[tuple[_Cycle, Measurement]]:
    """Yield each cycle and its measurement."""
    phi, taxels, period_s = layout.phi(), layout.taxels, layout.sync.period_s
    shape, random = (taxels.rows, taxels.columns), np.random.default_rng([seed, 7])
    kept = float(np.exp(-period_s / NOISE_MEMORY_S))
    memory_n = np.zeros(shape, np.float32)
    noise_n = sums_n = ideal_n = np.zeros(phi.shape[0])
    truth_n = zero_n = np.zeros(taxels.count)
    valid = np.ones(layout.blocks, np.bool_)
    for cycle in range(round(scene.seconds / period_s)):
        time_s = (cycle + 1) * period_s
        if cycle % STEP_CYCLES == 0:
            force_n = np.zeros(shape)
            for press in scene.presses:
                press.add_to(force_n, time_s)
            force_n.ravel()[list(taxels.untouchable or ())] = 0
            moment = force_n[None].astype(np.float32)
            felt_n, memory_n = creep(scene.creep, moment, memory_n, STEP_CYCLES * period_s)
            drift_n = sum((each.offsets_n(shape, np.array([time_s]))[0] for each in scene.drifts), np.zeros(shape))
            truth_n = force_n.ravel()
            zero_n = rest_n + drift_n.ravel() + (felt_n[0] - moment[0]).ravel() * (truth_n == 0)
            read_n = np.clip(rest_n + drift_n.ravel() + felt_n[0].ravel(), 0, taxels.force_max_n)
            sums_n, ideal_n = (np.asarray(phi.forward(each), np.float64) for each in (read_n, truth_n))
        noise_n = kept * noise_n + (1 - kept**2) ** 0.5 * random.normal(0, SUM_NOISE_N, noise_n.size)
        counts = np.rint((sums_n + noise_n) / taxels.newton_per_count).astype(np.int32)
        if scene.away:
            valid[: layout.blocks // 4] = not scene.away[0] <= time_s < scene.away[1]
        measurement = measurement_of(layout, phi, cycle, np.where(phi.sums_of_blocks(valid), counts, 0), valid)
        yield _Cycle(time_s, truth_n, zero_n, ideal_n + noise_n), measurement


class _Judge:
    """What a skin shows, beside the truth."""

    def __init__(self, layout: Layout, scene: Scene) -> None:
        taxels, self.phi = layout.taxels, layout.phi()
        self._shape = taxels.rows, taxels.columns
        defects = Defects.of({"offset": OFFSET_RATIO})
        (offsets_n,) = defects.effects(Stage.OFFSET, self._shape, taxels.force_max_n)
        self.rest_n: Floats = PEDESTAL_N + offsets_n.ravel().astype(np.float64)
        self._layout, self._scene = layout, scene
        self._shown, self._ideal = CycleImager(layout), CycleImager(layout).solver
        self.finder = FieldFinder(self.phi, taxels.surface)
        self._step_s = STEP_CYCLES * layout.sync.period_s
        self._life_s = np.zeros(taxels.count)
        self._near_s = np.full(taxels.count, np.inf)
        self._ghost_n = self._doubted_n = self._longest_s = self._away_n = self._moved_n = 0.0
        self._felt: list[tuple[float, float]] = []
        self._wrong_at_s = self._event_s = self._last_s = 0.0
        self._last_truth_n = np.zeros(taxels.count)
        self._all_sums = np.ones(self.phi.shape[0], np.bool_)
        self._steps = 0

    def take(self, cycle: _Cycle, made: Measurement) -> None:
        """Judge the measurement of a cycle."""
        time_s, truth_n, zero_n, ideal_sums_n = cycle
        if not made.offsets:
            return
        npc, forces = self._layout.taxels.newton_per_count, truth_n > 0
        image_n = self._shown.solve(decode_measurement(made, self.phi))[0].ravel().astype(np.float64)
        ideal_n = self._ideal.solve(ideal_sums_n.astype(np.float32), self._all_sums).ravel()
        near = binary_dilation(forces.reshape(self._shape), iterations=MARGIN).ravel() if forces.any() else forces
        self._near_s = np.where(near, 0.0, self._near_s + self._step_s)
        free = self._near_s > RELEASE_S
        found = doubtful_taxels(made, truth_n.size)
        in_doubt = np.zeros_like(forces) if found is None else found
        ghost_n = np.where(free, image_n, 0.0)
        is_ghost = ghost_n > max(GHOST_N, GHOST_PART * float(truth_n.max()))
        self._life_s = np.where(is_ghost & ~in_doubt, self._life_s + self._step_s, 0.0)
        self._longest_s = max(self._longest_s, float(self._life_s.max()))
        self._ghost_n = max(self._ghost_n, float(ghost_n[~in_doubt].max(initial=0.0)))
        self._doubted_n = max(self._doubted_n, float(ghost_n[in_doubt].max(initial=0.0)))
        if forces.any():
            self._felt.append((time_s, float(image_n[forces].sum() / max(float(ideal_n[forces].sum()), 1e-9))))
        self._judge_zero(
            time_s,
            zero_n,
            np.frombuffer(made.offsets, "<i4") * npc,
            moves=not np.array_equal(truth_n, self._last_truth_n),
        )
        self._last_truth_n = truth_n
        self._last_s = time_s
        self._steps += 1

    def _judge_zero(self, time_s: float, zero_n: Floats, offsets_n: Floats, *, moves: bool) -> None:
        """Judge the zero itself, a few times a second."""
        drift_n = max(float(np.abs(zero_n - self.rest_n).max()), self._scene.creep * float(self._last_truth_n.max()))
        if moves or drift_n > self._moved_n:
            self._event_s = time_s
        self._moved_n = max(self._moved_n, drift_n)
        if self._steps % STEP_CYCLES:
            return
        known = np.ones(offsets_n.size, np.bool_)
        off_n = self.finder.find(offsets_n - self.finder.sums(zero_n), known, SUM_NOISE_N).force_n
        self._away_n = max(self._away_n, float(np.abs(off_n).max()) - self._moved_n)
        if np.abs(off_n).max() > RIGHT_N:
            self._wrong_at_s = time_s

    def row(self) -> Row:
        """Return the figures of the scene."""
        felt, missed = [], 0
        for press in self._scene.presses:
            during = [part for time_s, part in self._felt if press.begin_s + 1 <= time_s < press.end_s - 0.1]
            halves = [float(np.mean(each)) for each in (during[: len(during) // 2], during[len(during) // 2 :]) if each]
            felt += halves
            missed += bool(halves) and min(halves) < MISSED_PART
        is_right = self._wrong_at_s < self._last_s - 1
        return {
            "ghost mN": round(1e3 * self._ghost_n, 2),
            "its life s": round(self._longest_s, 1),
            "in doubt mN": round(1e3 * self._doubted_n, 2),
            "felt": round(min(felt), 2) if felt else None,
            "missed": missed,
            "away mN": round(1e3 * max(0.0, self._away_n), 2),
            "right again s": round(max(0.0, self._wrong_at_s - self._event_s), 1) if is_right else None,
        }


def _named(layout: Layout) -> Iterator[Scene]:
    """Yield the named scenes."""
    board = tuple(layout.phi().taxels_of_blocks[_BOARD].tolist())
    places: list[tuple[str, Place, int]] = [("whole skin", "whole", 0), ("half", "half", 0)]
    places += [(f"{side} x {side}", "patch", side) for side in SIDES] + [("a board", "cells", 0)]
    for words, place, side in places:
        cells = board if place == "cells" else ()
        corner = (20, 20) if side else None
        for amount_n in STEPS_N:
            drift = ZeroDrift(place, "step", amount_n, 10, side=side, corner=corner, cells=cells)
            yield Scene(f"{words} steps by {1e3 * amount_n:+g} mN", 40, (drift,))
        for rate_n_per_s, amount_n in ((-1e-3, -5e-3), (-5e-5, -3e-3), (5e-5, 3e-3), (1e-3, 5e-3)):
            lasts_s = amount_n / rate_n_per_s
            drift = ZeroDrift(place, "ramp", amount_n, 10, lasts_s, side=side, corner=corner, cells=cells)
            yield Scene(
                f"{words} drifts by {1e3 * rate_n_per_s:+g} mN/s to {1e3 * amount_n:+g} mN", 35 + lasts_s, (drift,)
            )
    for force_n in (0.2e-3, 0.5e-3, 2e-3):
        hand = f"a hand of {1e3 * force_n:g} mN a taxel"
        yield Scene(f"{hand} at the start, for 20 s", 50, presses=(Press(0, 20, force_n, 20),))
        yield Scene(
            f"{hand} at the start, zero of the run before, 1 mN warmer",
            50,
            (ZeroDrift("whole", "step", 1e-3),),
            (Press(0, 20, force_n, 20),),
            is_stored=True,
        )
        for course in ("step", "ramp"):
            drift = ZeroDrift("whole", course, -2e-3, 20, 20.0 if course == "ramp" else None)
            yield Scene(
                f"{hand} during a {course} of the whole skin by -2 mN", 70, (drift,), (Press(10, 50, force_n, 20),)
            )
    sleeve = ZeroDrift("gradient", "step", 3e-3, 10), ZeroDrift("gradient", "step", -3e-3, 40)
    yield Scene("a sleeve is put on and taken off", 60, sleeve)
    yield Scene("a sleeve is put on and taken off, touched meanwhile", 60, sleeve, (Press(20, 30, 8e-3),))
    for amount_n, words in ((3e-3, "warms"), (-3e-3, "cools")):
        motor = ZeroDrift("patch", "ramp", amount_n, 10, 60, side=12, corner=(20, 20))
        slide = Press(15, 90, 8e-3, row=20, column=4, speed=8)
        yield Scene(
            f"a motor {words} 12 x 12 by 3 mN in a minute while an object slides over it", 100, (motor,), (slide,)
        )
    for ratio in (0.05, 0.1):
        yield Scene(f"a press of ten minutes, creep of {ratio:.0%}", 700, presses=(Press(10, 610, 10e-3),), creep=ratio)
    yield Scene("a touch of ten minutes of 2 mN", 640, presses=(Press(10, 610, 2e-3),))
    yield Scene(
        "a cup is filled: 12 x 12 by 1 mN in 120 s",
        150,
        (),
        tuple(Press(10 + k, 11 + k, k / 120 * 1e-3, 12) for k in range(120)),
    )
    yield Scene("zero forced under a hand of 2 mN", 60, presses=(Press(10, 35, 2e-3, 20),), tares=((15, None),))
    patch = ZeroDrift("patch", "step", 3e-3, 10, side=12, corner=(20, 20))
    yield Scene(
        "a warm patch settled by a region",
        60,
        (patch,),
        (Press(40, 50, 8e-3, row=45, column=45),),
        tares=((25, (18, 18, 33, 33)),),
    )
    yield Scene(
        "a quarter of the boards restarts while 12 x 12 fall by 3 mN",
        60,
        (ZeroDrift("patch", "step", -3e-3, 22, side=12, corner=(20, 20)),),
        away=(20.0, 25.0),
    )
    warms = ZeroDrift("whole", "ramp", 5e-3, 10, 5)
    yield Scene(
        "whole skin drifts by +1 mN/s to +5 mN, then all taxels but references are pressed",
        50,
        (warms,),
        (Press(25, 40, 8e-3, 64, 0, 0),),
        has_references=True,
    )
    yield Scene(
        "boards with thermometers cool by 3 mN in a minute, then warm by +1 mN/s",
        95,
        (ZeroDrift("whole", "ramp", -3e-3, 10, 60), ZeroDrift("whole", "ramp", 3e-3, 80, 3)),
        has_thermometers=True,
    )
    yield Scene("all taxels are pressed at once", 50, presses=(Press(10, 30, 8e-3, 64, 0, 0),))
    yield Scene("60 x 60 taxels are pressed at once", 50, presses=(Press(10, 30, 8e-3, 60, 2, 2),))


def _drawn(layout: Layout, seed: int, count: int) -> Iterator[Scene]:
    """Yield scenes with a drift and a touch that are drawn."""
    random = np.random.default_rng([seed, 11])
    rows, columns = layout.taxels.rows, layout.taxels.columns
    for number in range(count):
        side = int(random.integers(4, 25))
        place: Place = ("whole", "half", "gradient", "patch", "patch", "patch")[random.integers(6)]
        course = ("step", "ramp", "exponential")[random.integers(3)]
        amount_n = float(random.choice([-1, 1]) * random.uniform(0.5e-3, 5e-3))
        lasts_s = None if course == "step" else float(random.uniform(2, 60))
        corner = int(random.integers(0, rows - side)), int(random.integers(0, columns - side))
        drift = ZeroDrift(place, course, amount_n, float(random.uniform(5, 30)), lasts_s, side=side, corner=corner)
        of = int(random.integers(3, 20))
        begin_s = float(random.uniform(0, 40))
        press = Press(
            begin_s,
            begin_s + float(random.uniform(3, 40)),
            float(np.exp(random.uniform(np.log(0.5e-3), np.log(12e-3)))),
            of,
            int(random.integers(0, rows - of)),
            int(random.integers(0, columns - of)),
            float(random.choice([0, 0, 5, 20])),
        )
        where = f"patch of {side}" if place == "patch" else place
        words = f"drawn {number}: {where}, {course} by {1e3 * amount_n:+.1f} mN"
        words += f"; {1e3 * press.force_n:.1f} mN on {of} x {of}"
        yield Scene(words + (" slides" if press.speed else ""), 110, (drift,), (press,))
