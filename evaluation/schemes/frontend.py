"""What an analogue front end costs and gains: PSNR of each effect against nodes that add numbers."""

from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt

from calibration.gains import find_gains
from evaluation.result import Options, Result, Row
from evaluation.result_cache import measure_cells
from reconstructor.engine import Reconstructor
from reconstructor.gains import GainCorrection, KnownGains
from reconstructor.settings import LIVE, VARIATION
from skin.clipping import IDLE_DEVIATION
from skin.defects import Defects
from skin.frontend import SumConverter, SumModel, converter
from skin.layout import Layout, parse_layout
from skin.psnr import psnr_series_db
from skin.taxel import NOISE_N, sense, to_counts
from touch.contact import Force, Grid, Pose, press_along
from touch.objects import spheres_of
from touch.trajectory import ACQUISITION_OBJECTS, PAPER_DEPTH_M, PAPER_STEP_S, trajectory

#: Taxels of a block; 64 x 64 taxels, 1024 sums.
BLOCK_SIZES: Final = (8, 16, 32, 64, 128)
#: One step in `SPEED` of the trajectory is measured: 420 of 4200.
SPEED: Final = 10
QUICK_SPEED: Final = 300
OBJECTS: Final = tuple(ACQUISITION_OBJECTS)
#: Cycles whose mean is the offset after a tare: 2 s of 100 Hz.
TARE_CYCLES: Final = 200
#: Cycles without touch before the others, for the solver of the service.
IDLE_CYCLES: Final = 150
#: Lanes and steps of the rolled weight, taxels, and its force, newtons.
LANE: Final = 4.0
STEP: Final = 0.7
#: Cycles in which the weight rolls on by a step; the temporal filter averages them: 7 mm/s at 100 Hz.
ROLLED_CYCLES: Final = 40
_ROLLED: Final = "golf-ball"


@dataclass(frozen=True)
class Effect:
    """A front end: the bits of its converters, and what is wrong with it.

    Attributes
    ----------
    words : str
    is_digital : bool
        A converter of ten bits for each taxel; nothing else counts then.
    bits : int
        Of the converter of a sum; 0 for an exact one.
    mismatch, offset_n, noise_n, row_s
        As of `skin.defects`.
    is_calibrated : bool
        The gains of the sums were found from a rolled weight.
    is_tared : bool
        The offsets were measured.
    slide : float
        Speed of the touch after SYNC / the paper's 45 mm/s.
    knows_gains : bool
        The gains of the sums are known exactly.
    keeps_penalty : bool
        λ is that of sums of 32 taxels with clipped noise; else λ is scaled with the noise of untouched sums.
    is_live : bool
        The solver of the service, which averages over cycles and scales λ by itself, in place of single cycles.
    """

    words: str
    is_digital: bool = False
    bits: int = 0
    mismatch: float = 0.0
    offset_n: float = 0.0
    noise_n: float = 0.0
    row_s: float = 0.0
    is_calibrated: bool = False
    is_tared: bool = False
    slide: float = 1.0
    knows_gains: bool = False
    keeps_penalty: bool = False
    is_live: bool = False

    @property
    def is_wrong(self) -> bool:
        """Whether the front end is analogue and not perfect."""
        return any((self.bits, self.mismatch, self.offset_n, self.noise_n, self.row_s))

    @property
    def is_perfect(self) -> bool:
        """Whether others are compared with this front end."""
        return not (self.is_wrong or self.is_digital or self.keeps_penalty or self.is_live)


EFFECTS: Final = (
    Effect("digital: a converter of 10 bits for each taxel", is_digital=True),
    Effect("analogue: no clipping, exact converters, same λ", keeps_penalty=True),
    Effect("analogue, λ that fits its noise"),
    Effect("digital, `live`", is_digital=True, is_live=True),
    Effect("analogue, `live`", is_live=True),
    Effect("converters of 12 bits", bits=12),
    Effect("converters of 10 bits", bits=10),
    Effect("converters of 8 bits", bits=8),
    Effect("mismatch 0.1 %", mismatch=1e-3),
    Effect("mismatch 1 %", mismatch=1e-2),
    Effect("mismatch 5 %", mismatch=5e-2),
    Effect("mismatch 5 %, gains from a roll", mismatch=5e-2, is_calibrated=True),
    Effect("mismatch 5 %, gains of sums known", mismatch=5e-2, knows_gains=True),
    Effect("offsets of sums, 10 mN", offset_n=1e-2),
    Effect("offsets of sums, 10 mN, tared", offset_n=1e-2, is_tared=True),
    Effect("noise of a sum, 1 mN", noise_n=1e-3),
    Effect("noise of a sum, 5 mN", noise_n=5e-3),
    Effect("rows 0.1 ms apart, slide of 45 mm/s", row_s=1e-4),
    Effect("rows 0.1 ms apart, slide of 450 mm/s", row_s=1e-4, slide=10.0),
    Effect("rows 0.5 ms apart, slide of 45 mm/s", row_s=5e-4),
)


def evaluate(options: Options) -> Result:
    """Return a row for each effect: PSNR of both front ends, then what each effect costs, by size of the blocks."""
    speed = QUICK_SPEED if options.quick else SPEED
    cells = [
        {**options.shared, "speed": speed, "size": size, "effect": asdict(effect)}
        for effect in EFFECTS
        for size in BLOCK_SIZES
    ]
    found = measure_cells(measure, cells, options, "front ends")
    psnr_db = np.array([each["psnr_db"] for each in found]).reshape(len(EFFECTS), -1)
    perfect_db = psnr_db[[effect.is_perfect for effect in EFFECTS].index(True)]
    rows: list[Row] = []
    for effect, its_db in zip(EFFECTS, psnr_db, strict=True):
        shown = its_db - perfect_db if effect.is_wrong else its_db
        columns = {f"B = {size}": round(float(each), 2) + 0.0 for size, each in zip(BLOCK_SIZES, shown, strict=True)}
        rows.append({"front end": effect.words, "shown": "change, dB" if effect.is_wrong else "PSNR, dB", **columns})
    note = (
        f"{found[0]['frames']} images in each cell. Change: PSNR - PSNR of an analogue front end with λ that fits its"
        " noise. Total variation on sums of one cycle, but for `live`; a sum that saturates is left out."
    )
    return Result("Front ends, 64 x 64 taxels, 1024 sums", rows, note=note)


def measure(*, meshes: str | None, seed: int, speed: int, size: int, effect: Row) -> Row:
    """Return the mean PSNR over the images of all objects, and their number."""
    board = _Board(Effect(**effect), size, seed)
    found = [board.psnr_db(name, meshes, speed) for name in OBJECTS]
    return {"psnr_db": float(np.mean([each.mean() for each in found])), "frames": sum(map(len, found))}


@lru_cache(maxsize=len(OBJECTS))
def _touch(name: str, meshes: str | None, speed: int) -> Force:
    return trajectory(name, meshes=meshes, speed=speed)


class _Board:
    """All boards of a skin."""

    def __init__(self, effect: Effect, size: int, seed: int) -> None:
        self._effect, self._seed = effect, seed
        self._layout = _layout(size, effect.bits or 10)
        self._phi, taxels = self._layout.phi(), self._layout.taxels
        self._converter: SumConverter | None = converter(self._layout) if effect.bits else None
        amounts = {
            "mismatch": effect.mismatch,
            "sum_offset": effect.offset_n,
            "sum_noise": effect.noise_n,
            "skew": effect.row_s,
        }
        self._model = SumModel(self._phi, Defects.of(amounts, seed))
        settings = LIVE if effect.is_live else VARIATION
        if not (effect.is_digital or effect.keeps_penalty or effect.is_live):
            settings = replace(settings, penalty_n=settings.penalty_n * (size / 32) ** 0.5 / IDLE_DEVIATION)
        self._engine = Reconstructor(self._phi, taxels.rows, taxels.columns, settings)
        self._zero_n: Force | float = 0.0
        if effect.is_tared:
            still = np.zeros((TARE_CYCLES, taxels.count), np.float32)
            self._zero_n = self._sums_n(still, None, np.random.default_rng([seed, 1])).mean(axis=0)
        self._gains: KnownGains | None = None
        if effect.knows_gains and self._model.gains is not None:
            self._gains = KnownGains(np.ones(taxels.count), self._model.gains)
        elif effect.is_calibrated:
            self._gains = self._rolled()

    def psnr_db(self, name: str, meshes: str | None, speed: int) -> npt.NDArray[np.float64]:
        """Return the PSNR of each image of a touch."""
        true = _touch(name, meshes, speed)
        flat = true.reshape(len(true), -1)
        change = np.diff(flat, axis=0, append=flat[-1:]) * np.float32(self._effect.slide / (speed * PAPER_STEP_S))
        idle = 0
        if self._effect.is_live:  # the filter learns the noise of the sums
            idle = IDLE_CYCLES
            flat, change = (
                np.concatenate([np.zeros((idle, flat.shape[1]), np.float32), each]) for each in (flat, change)
            )
        random = np.random.default_rng([self._seed, OBJECTS.index(name)])
        if self._effect.is_digital:
            taxels = self._layout.taxels
            counts = to_counts(sense(flat, random), taxels)
            sums_n = np.asarray(self._phi.forward(counts), np.float32) * np.float32(taxels.newton_per_count)
        else:
            sums_n = self._sums_n(flat, change, random)
        return psnr_series_db(true, self._images(sums_n)[idle:])

    def _sums_n(
        self, force_n: Force, change_n_per_s: Force | None, random: np.random.Generator, *, averaged: int = 1
    ) -> Force:
        """Return what the converters read, newtons, shape (frames, m); NaN where they saturate.

        Each frame is the mean of `averaged` cycles.
        """
        noise_n = np.float32(NOISE_N / averaged**0.5)
        read_n = force_n + noise_n * random.standard_normal(force_n.shape, np.float32)
        sums_n = self._model.sums_n(read_n, random, change_n_per_s=change_n_per_s)
        if self._converter is None:
            return sums_n
        counts = self._converter.counts(sums_n)
        newtons = counts * np.float32(self._layout.taxels.newton_per_count)
        return np.where(self._converter.is_saturated(counts), np.float32(np.nan), newtons).astype(np.float32)

    def _images(self, sums_n: Force) -> list[Force]:
        correction = GainCorrection(self._phi, self._gains) if self._gains is not None else None
        self._engine.restart()
        images = []
        for each in sums_n - self._zero_n:
            valid = np.isfinite(each)
            if correction is None:
                images.append(self._engine.solve(each, valid))
                continue
            images.append(self._engine.solve(*correction.apply(each, valid)))
            correction.keep(images[-1])
        return images

    def _rolled(self) -> KnownGains:
        """Return the gains that a ball tells that is rolled over the skin."""
        taxels = self._layout.taxels
        half_m = taxels.rows * taxels.pitch_m / 2
        lanes = np.arange(-half_m, half_m, LANE * taxels.pitch_m)
        steps = np.arange(-half_m, half_m, STEP * taxels.pitch_m)
        poses = (Pose(float(x), float(y), 0.0, PAPER_DEPTH_M) for x in lanes for y in steps)
        force_n = press_along(Grid(), spheres_of(_ROLLED, None), poses)
        random = np.random.default_rng([self._seed, 2])
        sums_n = self._sums_n(force_n.reshape(len(force_n), -1), None, random, averaged=ROLLED_CYCLES)
        images = np.stack(self._images(sums_n))
        weight_n = float(np.median(force_n.sum(axis=(1, 2))))
        found = find_gains(self._phi, taxels.surface, sums_n.astype(np.float64), images, weight_n, is_analogue=True)
        return KnownGains(found.gains, found.sums)


def _layout(size: int, bits: int) -> Layout:
    text = (
        f'[taxels]\nrows = 64\ncolumns = 64\nfrontend = "analogue"\nadc_bits = {bits}\n'
        f"[measurement]\nsums = 1024\nblock_size = {size}\n"
    )
    return parse_layout(text.encode(), f"B = {size}")
