"""`Reconstructor`: one tactile image per cycle, warm-started from the last."""

from typing import Any, Final, TypedDict

import numpy as np
import numpy.typing as npt

from reconstructor.kernels.fused import FusedHaar, HaarForm
from skin.errors import InputError
from skin.measurement import Sbhe


class Settings(TypedDict):
    """The keyword arguments of `Reconstructor`."""

    iterations: int
    penalty_n: float
    lipschitz_ratio: float
    basis: HaarForm
    spins: int
    nonnegative: bool
    matched: bool


#: The image of the live page: cycle spinning and non-negativity inside the iteration, the exact step.
LIVE: Final[Settings] = {
    "iterations": 20,
    "penalty_n": 0.008,
    "lipschitz_ratio": 1.0,
    "basis": "pyramid",
    "spins": 16,
    "nonnegative": True,
    "matched": True,
}

#: The solver of the paper: tensor Haar, L = 2B, 20 iterations, negative taxels set to 0 at the end alone. The
#: printed λ = 0.1 does not give its tables; an eighth of it does.
PAPER: Final[Settings] = {
    "iterations": 20,
    "penalty_n": 0.0125,
    "lipschitz_ratio": 2.0,
    "basis": "tensor",
    "spins": 1,
    "nonnegative": False,
    "matched": False,
}


class Reconstructor:
    """The solver of the service.

    Every call starts from the previous image. A start from an image that no longer fits would leave its ghost in
    the null space of Φ, so the start is first scaled by how well it explains the new sums (`matched`): all of it
    while a touch moves slowly, nothing of it when another touch has taken its place.

    The taxels of a block whose sums are not valid are not measured: within a cycle or two they show what the measured
    taxels around them make likely, somewhat too little, and nothing of the past stays frozen there. Without any valid
    sum the image is zero and the past is forgotten.

    Parameters
    ----------
    phi : Sbhe
        The skin's Φ.
    rows, columns : int
        The grid, powers of two from 8 to 256.
    iterations, penalty_n, lipschitz_ratio, basis, spins, nonnegative, matched
        See `FusedHaar`; `LIVE` without, and ``**PAPER`` for the paper's solver.
    dtype : float32 or float64
        Of all arithmetic.

    Raises
    ------
    InputError
        If an option does not fit.
    """

    def __init__(
        self,
        phi: Sbhe,
        rows: int,
        columns: int,
        *,
        iterations: int = LIVE["iterations"],
        penalty_n: float = LIVE["penalty_n"],
        lipschitz_ratio: float = LIVE["lipschitz_ratio"],
        basis: HaarForm = LIVE["basis"],
        spins: int = LIVE["spins"],
        nonnegative: bool = LIVE["nonnegative"],
        matched: bool = LIVE["matched"],
        dtype: npt.DTypeLike = np.float32,
    ) -> None:
        self._kernel = FusedHaar(
            phi,
            rows,
            columns,
            iterations=iterations,
            penalty_n=penalty_n,
            lipschitz_ratio=lipschitz_ratio,
            basis=basis,
            spins=spins,
            nonnegative=nonnegative,
            matched=matched,
            dtype=dtype,
        )
        self._sums = np.zeros(phi.shape[0], self._kernel.dtype)
        self._estimate = np.zeros(phi.shape[1], self._kernel.dtype)

    def solve(
        self, sums_n: npt.NDArray[np.floating[Any]], valid_sums: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.float32]:
        """Return the image of one cycle.

        Parameters
        ----------
        sums_n : array, shape (m,)
            Newtons; what stands where a sum is not valid has no effect.
        valid_sums : array of bool, shape (m,)

        Returns
        -------
        array of float32, shape (rows, columns)
            Newtons, never negative.

        Raises
        ------
        InputError
            If the shapes differ from Φ's or a valid sum is not finite.
        """
        if sums_n.shape != self._sums.shape or valid_sums.shape != self._sums.shape:
            raise InputError(
                f"Φ gives {self._sums.size} sums: got sums of shape {sums_n.shape} and validity of {valid_sums.shape}"
            )
        self._sums[:] = 0
        np.copyto(self._sums, sums_n, where=valid_sums, casting="same_kind")
        if not np.isfinite(self._sums).all():
            raise InputError("a valid sum is not finite: expected newtons")
        if not self._kernel.solve(self._estimate, self._sums, valid_sums):
            self.reset()
        image = self._kernel.image_of(self._estimate)
        return np.maximum(image, 0, out=image).astype(np.float32, copy=False)

    def reset(self) -> None:
        """Forget the previous image."""
        self._estimate[:] = 0

    def warm_up(self) -> None:
        """Compile, or load what was compiled before, so that the first cycle is as fast as the others."""
        valid = np.ones(self._sums.size, np.bool_)
        self.solve(np.zeros_like(self._sums), valid)
        self.reset()
