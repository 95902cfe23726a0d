"""`SteppedImager`: an image of the newest sums of a skin with steps."""

from typing import Any

import numpy as np
import numpy.typing as npt

from reconstructor.corrections import Corrections
from reconstructor.engine import Reconstructor
from reconstructor.walsh import WalshReconstructor
from skin.layout import Layout
from skin.measured_sums import SteppedSums, decode_stepped
from skin.taxel import NOISE_N
from skin.walsh import grouped_rows


class SteppedImager:
    """Images of steps, see `reconstructor.walsh`; for the service as `reconstructor.imaging.CycleImager`.

    Only the newest measurement counts: it holds all that those before held. Sums that are not known are filled in from
    the forces around: those of dead nodes, and groups that have not come.

    Parameters
    ----------
    layout : Layout
        With steps.
    solver : Reconstructor, optional
        Without temporal filter: it makes the images from the rows of Φ whose sums are known.
    about : str
        Words for the log.
    """

    depth = 1
    decode = staticmethod(decode_stepped)

    def __init__(self, layout: Layout, solver: Reconstructor | None = None, about: str = "steps") -> None:
        taxels = layout.taxels
        self.about = about
        self._solver = solver
        self._walsh = WalshReconstructor(layout.patches(), taxels.rows, taxels.columns, NOISE_N, taxels.surface.graph)
        self._shape = (layout.blocks, layout.measurement.block_size)
        #: A patch's sums come by Hadamard row, and are solved group by group.
        self._rows = grouped_rows(layout.measurement.block_size).ravel()
        self._corrections = Corrections(layout)

    def solve(self, sums: SteppedSums) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        """See `reconstructor.imaging.CycleImager.solve`; the image is 0 while no sum is known."""
        sums_n, known = self._corrections.apply(sums.counts, sums.known)
        if self._solver is not None:
            image = self._solver.solve(sums_n, known)
        else:
            self._walsh.noise_n = sums.noise_n or NOISE_N
            image = self._walsh.solve(self._grouped(sums_n), None if known.all() else self._grouped(known))
        return self._corrections.keep(image), known

    def _grouped(self, of_sums: Any) -> Any:
        return np.take(of_sums.reshape(self._shape), self._rows, axis=1)

    def warm_up(self) -> None:
        """Compile the solver, or load the compiled solver."""
        if self._solver is not None:
            self._solver.warm_up()
            return
        blocks, size = self._shape
        nothing = np.zeros(size * blocks, np.int32)
        for known in (np.arange(nothing.size) > 0, np.ones(nothing.size, np.bool_)):
            self.solve(SteppedSums(nothing, np.ones(blocks, np.bool_), known, NOISE_N))
        self._walsh.reset()
