"""Images of measurements: of one cycle after another, or of the newest steps."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.corrections import Corrections
from reconstructor.engine import Reconstructor
from reconstructor.gains import KnownGains
from reconstructor.options import SolverOptions
from reconstructor.stepped import SteppedImager
from skin.calibration_file import load_calibration
from skin.layout import Layout, require_sending
from skin.matrix import MatrixPhi
from skin.measured_sums import MeasuredSums, decode_measurement
from skin.phi import Sbhe


class CycleImager:
    """Images of cycles.

    Parameters
    ----------
    gains : KnownGains, optional
        Of taxels and sums: they are taken off.

    Attributes
    ----------
    about : str
        Words for the log.
    depth : int
        Most measurements that wait during a solve; a longer queue would only make images older.
    decode : callable
        Decodes a measurement.
    solver : Reconstructor
    """

    depth = 4
    decode = staticmethod(decode_measurement)

    def __init__(self, layout: Layout, options: SolverOptions | None = None, gains: KnownGains | None = None) -> None:
        chosen = options or SolverOptions()
        self._phi = layout.operator()
        self.about, self.solver = _about(chosen), _solver(layout, self._phi, chosen)
        self.warm_up = self.solver.warm_up
        self._corrections = Corrections(layout, gains)

    def solve(self, sums: MeasuredSums) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """Return the image, float32, shape (rows, columns), newtons; and which sums it is made from, shape (m,)."""
        sums_n, valid_sums = self._corrections.apply(sums.counts, sums.valid_sums)
        image = self.solver.solve(sums_n, valid_sums, self._phi.of_cycle(sums.cycle))
        return self._corrections.keep(image), valid_sums


def _about(options: SolverOptions) -> str:
    settings = options.settings()
    basis = f", basis {settings.prior}" if options.basis else ""
    return f"{settings.iterations} iterations{basis}"


def _solver(layout: Layout, phi: Sbhe | MatrixPhi, options: SolverOptions) -> Reconstructor:
    taxels = layout.taxels
    return Reconstructor(
        phi,
        taxels.rows,
        taxels.columns,
        options.settings(),
        noise_n=options.clipped_noise_n(layout),
        samples=layout.samples_per_sync,
        turns=layout.sync.turns,
        edges=taxels.surface.graph,
    )


#: What makes the images of a skin.
Imager = CycleImager | SteppedImager


def make_imager(layout: Layout, options: SolverOptions | None = None, gains: Path | None = None) -> Imager:
    """Return what makes the images of a skin.

    Parameters
    ----------
    gains : pathlib.Path, optional
        File of ``skin calibration gain``.
    """
    if layout.sends.in_cycles:
        return CycleImager(layout, options, None if gains is None else load_gains(gains, layout))
    if gains is not None:
        require_sending(layout, "synchronous", "--gains is", "write gains to stepped boards (2010h)")
    if options is None:
        return SteppedImager(layout)
    options.check(layout)
    return SteppedImager(layout, _solver(layout, layout.operator(), options), f"steps, {_about(options)}")


def load_gains(path: Path, layout: Layout) -> KnownGains:
    """Return the gains in a file."""
    stored = load_calibration(path, layout)
    if not stored.gains:
        raise InputError(f"{path}: has no gains of taxels: expected a file of 'skin calibration gain'")
    return KnownGains(np.array(stored.gains), stored.sum_gains())
