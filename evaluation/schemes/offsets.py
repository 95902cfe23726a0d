"""``skin evaluate offsets``: images and labels of a skin with offsets, gains and drift, raw and calibrated."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from calibration.calibrator import Calibrator
from calibration.offline import measurement_of
from canskin.calibration_messages import CalibrationState
from canskin.messages import Measurement
from classifier.cache import find_or_train
from classifier.decide import Classifier
from classifier.model import Model
from evaluation.result import Options, Result, Row
from evaluation.result_cache import measure_cells
from evaluation.schemes.scenes import SLIDES
from nodes.averaging import SampleFilter
from reconstructor.imaging import CycleImager
from skin.defects import Defects
from skin.layout import Layout, load_layout
from skin.measured_sums import decode_measurement
from skin.psnr import decibels
from skin.taxel import TaxelModel, to_counts
from touch.contact import Force
from touch.strokes import LABEL_FORCE_N
from touch.trajectory import trajectory

#: Offsets up to this part of the range, and deviation of the gains.
OFFSET_RATIO: Final = 0.13
GAIN_DEVIATION: Final = 0.1
#: Drift of every sum, and of every taxel: the rates have random signs, or a normal distribution.
SUM_DRIFT_N_PER_S: Final = 1e-3
TAXEL_DRIFT_N_PER_S: Final = 2e-5
#: Time without touch before the object; a hand rests for the first part of it.
REST_S: Final = 5.0
DRIFT_REST_S: Final = 60.0
HAND_S: Final = 4.0
#: Side of the hand, taxels, and the force on each taxel.
HAND_TAXELS: Final = 20
HAND_N: Final = 0.004
#: The object presses and slides.
SLIDE_S: Final = 2.4
#: PSNR counts from here on: the object is in.
PRESSED_S: Final = 0.5


@dataclass(frozen=True)
class Case:
    """What is wrong with the skin, and what happens before the object.

    Attributes
    ----------
    words : str
    offset, gain : bool
    sum_drift, taxel_drift : bool
    hand : bool
        A hand lies on the skin at the start.
    rest_s : float
    """

    words: str
    offset: bool = True
    gain: bool = True
    sum_drift: bool = False
    taxel_drift: bool = False
    hand: bool = False
    rest_s: float = REST_S


CASES: Final = (
    Case("nothing", offset=False, gain=False),
    Case("offsets", gain=False),
    Case("offsets, gains"),
    Case("offsets, gains, a hand at the start", hand=True, rest_s=HAND_S + REST_S),
    Case("offsets, gains, every sum drifts 1 mN/s", sum_drift=True, rest_s=DRIFT_REST_S),
    Case("offsets, gains, taxels drift 0.02 mN/s rms", taxel_drift=True, rest_s=DRIFT_REST_S),
)


def evaluate(options: Options) -> Result:
    """Measure a slide of the golf ball on skins with offsets, gains and drift, in cycles of the default skin.

    Parameters
    ----------
    options : Options
        `quick` leaves out the minutes of drift.
    """
    places = [place for place, case in enumerate(CASES) if not options.quick or case.rest_s < DRIFT_REST_S]
    cells: list[Row] = [{"place": place, **options.shared} for place in places]
    rows = measure_cells(measure_offsets, cells, options, "offsets")
    return Result(
        "Calibration of the default skin: PSNR of a slide of the golf ball, labels",
        [{"skin has": CASES[place].words, **row} for place, row in zip(places, rows, strict=True)],
        note="No offsets: the same gains and noise, without offsets and drift. Raw: without calibration. Untouched:"
        " part of the last second before the object in which the skin was called untouched.",
    )


def measure_offsets(place: int, meshes: str | None, seed: int, *, labels: bool = True) -> Row:
    """Return what calibration makes of one of `CASES`.

    Returns
    -------
    dict
        Whether something was seen to touch the skin at the start; PSNR in dB without offsets, raw and calibrated; parts
        of cycles in which the untouched skin is called untouched, and the object by its name; None without `labels`.
    """
    case, layout = CASES[place], load_layout()
    phi = layout.phi()
    slide = trajectory(SLIDES[0], meshes=meshes, steps=round(1e3 * SLIDE_S))
    ideal = Case("", offset=False, gain=case.gain)
    truth = list(_truth(layout, case, slide))
    model = find_or_train(layout, phi) if labels else None
    without, raw, calibrated = (_Judge(layout, len(truth), each) for each in (None, model, model))
    calibrator = Calibrator(layout)
    was_touched = False
    for cycle, (fine, sums) in enumerate(
        zip(_sums(layout, ideal, truth, seed), _sums(layout, case, truth, seed), strict=True)
    ):
        true_n = truth[cycle][-1]
        without.take(measurement_of(layout, phi, cycle, fine), true_n)
        made = measurement_of(layout, phi, cycle, sums)
        raw.take(made, true_n)
        calibrated.take(calibrator.apply(made), true_n)
        calibrator.take(made)
        calibrator.work()
        was_touched |= calibrator.state is CalibrationState.TOUCHED
    return {
        "touched at the start": was_touched,
        "no offsets dB": without.psnr_db(),
        "raw dB": raw.psnr_db(),
        "calibrated dB": calibrated.psnr_db(),
        "untouched raw": raw.untouched(),
        "untouched calibrated": calibrated.untouched(),
        "label raw": raw.right(),
        "label calibrated": calibrated.right(),
    }


class _Judge:
    """Images and labels of a run, judged."""

    def __init__(self, layout: Layout, cycles: int, model: Model | None) -> None:
        self._phi, self._force_max_n, rate_hz = layout.phi(), layout.taxels.force_max_n, layout.sync.rate_hz
        self._imager = CycleImager(layout)
        self._classifier = None if model is None else Classifier(model, self._phi)
        self._slides_at = cycles - round(SLIDE_S * rate_hz)
        self._pressed_at = self._slides_at + round(PRESSED_S * rate_hz)
        self._rests_at = self._slides_at - round(rate_hz)
        self._squares: list[float] = []
        self._untouched: list[bool] = []
        self._right: list[bool] = []

    def take(self, measurement: Measurement, true_n: Force) -> None:
        """Judge a cycle from the last second of the rest on."""
        cycle = measurement.cycle - 1
        if cycle < self._rests_at:
            return
        sums = decode_measurement(measurement, self._phi)
        image, _ = self._imager.solve(sums)
        if cycle >= self._pressed_at:
            self._squares.append(float(np.mean(np.square(image - true_n, dtype=np.float64))))
        if self._classifier is not None:
            label = self._classifier.decide(sums.counts, sums.valid, cycle).label
            if cycle < self._slides_at:
                self._untouched.append(not label)
            elif cycle >= self._pressed_at and true_n.max() >= LABEL_FORCE_N:
                self._right.append(label == SLIDES[0])

    def psnr_db(self) -> float:
        """Return the PSNR of the images of the object, by their mean square error."""
        return round(float(decibels(np.mean(self._squares), self._force_max_n)), 1)

    def untouched(self) -> float | None:
        """Return the part of the untouched cycles that were called so."""
        return round(float(np.mean(self._untouched)), 3) if self._untouched else None

    def right(self) -> float | None:
        """Return the part of the touched cycles with the right label."""
        return round(float(np.mean(self._right)), 3) if self._right else None


def _truth(layout: Layout, case: Case, slide: Force) -> Iterator[Force]:
    """Yield the true forces of the samples of each cycle, shape (samples, rows, columns)."""
    samples, rate_hz = layout.samples_per_sync, layout.sync.rate_hz
    nothing = np.zeros((samples, layout.taxels.rows, layout.taxels.columns), np.float32)
    hand = nothing.copy()
    hand[:, 10 : 10 + HAND_TAXELS, 30 : 30 + HAND_TAXELS] = HAND_N
    for cycle in range(round(case.rest_s * rate_hz)):
        yield hand if case.hand and cycle < HAND_S * rate_hz else nothing
    for begin in range(0, len(slide) - samples + 1, samples):
        yield slide[begin : begin + samples]


def _sums(layout: Layout, case: Case, truth: list[Force], seed: int) -> Iterator[npt.NDArray[np.int32]]:
    """Yield the sums of each cycle, as nodes make them of what taxels read."""
    phi, taxels, random = layout.phi(), layout.taxels, np.random.default_rng(seed)
    amounts = {
        "offset": OFFSET_RATIO * case.offset,
        "gain_spread": GAIN_DEVIATION * case.gain,
        "drift": TAXEL_DRIFT_N_PER_S * case.taxel_drift,
    }
    model = TaxelModel(force_max_n=taxels.force_max_n, defects=Defects.of(amounts, seed))
    average = SampleFilter(phi.taxels_of_blocks)
    period_s, samples = layout.sync.period_s, layout.samples_per_sync
    parts_s = period_s * np.arange(1 - samples, 1) / samples
    drift = np.random.default_rng([seed, 1]).choice([-1.0, 1.0], phi.shape[0]) * SUM_DRIFT_N_PER_S
    for cycle, force_n in enumerate(truth):
        read_n = model.signal_of_moments(force_n, random, parts_s + cycle * period_s)
        average.take(to_counts(read_n.reshape(samples, -1), taxels).astype(np.float32))
        sums = np.asarray(phi.forward(average.counts), np.float64)
        if case.sum_drift:
            sums += drift * (cycle * period_s / taxels.newton_per_count)
        yield np.rint(sums).astype(np.int32)
