"""Images of measurements: of one cycle after another, or of the newest adaptive sums."""

import time
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import Measurement
from reconstructor.adaptive import AdaptiveReconstructor
from reconstructor.engine import Reconstructor
from reconstructor.gains import GainCorrection, KnownGains
from reconstructor.options import SolverOptions
from skin.calibration_file import load_calibration
from skin.layout import Layout, require_sending
from skin.measured_sums import MeasurementReader, decode_adaptive, decode_measurement

#: An image in newtons, shape (rows, columns), the number of sums used, and the time of the solver in seconds.
Solved = tuple[npt.NDArray[np.float32], int, float]


class Imager(Protocol):
    """Makes images of the measurements of one skin.

    Attributes
    ----------
    about : str
        Words for the log.
    depth : int
        Most measurements that wait during a solve; a longer queue would only make images older.
    reader : MeasurementReader
    """

    about: str
    depth: ClassVar[int]
    reader: MeasurementReader[Any]

    def warm_up(self) -> None:
        """Compile the solver, or load the compiled solver."""
        ...

    def solve(self, measurement: Measurement) -> Solved | None:
        """Return the image of a measurement; None if the measurement is refused."""
        ...


class CycleImager:
    """Images of cycles; see `Imager`.

    Parameters
    ----------
    layout : Layout
    options : SolverOptions, optional
    gains : KnownGains, optional
        Of taxels and sums: they are taken off.

    Raises
    ------
    InputError
        If the options do not fit the skin.
    """

    depth: ClassVar[int] = 4

    def __init__(self, layout: Layout, options: SolverOptions | None = None, gains: KnownGains | None = None) -> None:
        chosen, phi, taxels = options or SolverOptions(), layout.phi(), layout.taxels
        settings = chosen.settings()
        basis = f", basis {settings.prior}" if chosen.basis else ""
        self.about = f"{settings.iterations} iterations{basis}"
        self._solver = Reconstructor(
            phi,
            taxels.rows,
            taxels.columns,
            settings,
            noise_n=chosen.clipped_noise_n(layout),
            samples=layout.samples_per_sync,
        )
        self.warm_up = self._solver.warm_up
        self._newton_per_count = np.float32(taxels.newton_per_count)
        self._gains = None if gains is None else GainCorrection(phi, gains)
        self.reader = MeasurementReader(phi, "reconstructor", decode_measurement)

    def solve(self, measurement: Measurement) -> Solved | None:
        """See `Imager`."""
        sums = self.reader.read(measurement)
        if sums is None:
            return None
        started_s = time.perf_counter()
        sums_n = np.multiply(sums.counts, self._newton_per_count, dtype=np.float32)
        valid_sums = sums.valid_sums
        if self._gains is not None:
            sums_n, valid_sums = self._gains.apply(sums_n, valid_sums)
        image = self._solver.solve(sums_n, valid_sums)
        if self._gains is not None:
            self._gains.keep(image)
        return image, int(np.count_nonzero(valid_sums)), time.perf_counter() - started_s


class AdaptiveImager:
    """Images of adaptive sums; see `Imager`. Only the newest measurement counts: it holds all that those before had."""

    about = "adaptive sums"
    depth: ClassVar[int] = 1

    def __init__(self, layout: Layout) -> None:
        self._solver = AdaptiveReconstructor(layout)
        self.warm_up = self._solver.warm_up
        self.reader = MeasurementReader(layout.phi(), "reconstructor", decode_adaptive)

    def solve(self, measurement: Measurement) -> Solved | None:
        """See `Imager`."""
        sums = self.reader.read(measurement)
        if sums is None:
            return None
        started_s = time.perf_counter()
        image = self._solver.solve(sums)
        return image, int(np.count_nonzero(sums.known)), time.perf_counter() - started_s


def make_imager(layout: Layout, options: SolverOptions | None = None, gains: Path | None = None) -> Imager:
    """Return what makes the images of a skin.

    Parameters
    ----------
    layout : Layout
    options : SolverOptions, optional
    gains : pathlib.Path, optional
        File of ``skin calibration gain``.

    Raises
    ------
    InputError
        If an option or the gains do not fit the skin.
    """
    if layout.sends.in_cycles:
        return CycleImager(layout, options, None if gains is None else load_gains(gains, layout))
    if options is not None:
        flags = "--solver, --iterations, --basis, --penalty-n and --noise-n are"
        require_sending(layout, "synchronous", flags, "adaptive sums have a solver of their own; leave them out")
    if gains is not None:
        require_sending(layout, "synchronous", "--gains is", "write gains to adaptive boards (2010h)")
    return AdaptiveImager(layout)


def load_gains(path: Path, layout: Layout) -> KnownGains:
    """Return the gains in a file.

    Raises
    ------
    InputError
        If the file has none.
    """
    stored = load_calibration(path, layout)
    if not stored.gains:
        raise InputError(f"{path}: has no gains of taxels: expected a file of 'skin calibration gain'")
    return KnownGains(np.array(stored.gains), stored.sum_gains())
