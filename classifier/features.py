"""Features of one measurement: energies and peaks that do not depend on the position of the object.

A linear function of the sums cannot name an object at every position and depth. Therefore the adjoint image Φᵀy is
smoothed at several widths. The energy (a quadratic form of the sums) and the peak of each smoothed image do not depend
on position and rotation of the object. Hadamard row 0 of a block, the plain sum of its taxels, is left out: only this
row changes with a common offset of the taxels (clipped noise, drift). Of sums of any matrix, what a common offset adds
is taken off: y less its part along Φ1.

The smoothing kernels are Gaussians: on a grid the product of one over the rows and one over the columns, on other skins
of the distance in space, among taxels that face the same side.
"""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.matrix import MatrixPhi
from skin.phi import Phi, Sbhe, fast_hadamard
from skin.surface import Surface

Float32 = npt.NDArray[np.float32]

#: Standard deviations of the smoothing kernels in pitches. The first, and those of at most a quarter of the skin.
WIDTHS: Final = (0.5, 0.8, 1.2, 1.8, 2.7, 4.0, 6.0, 9.0, 14.0)

#: Smaller weights are 0: products of two would be subnormal numbers, which take 100 times as long to multiply.
_LEAST_WEIGHT: Final = np.sqrt(np.finfo(np.float32).tiny)
#: Distance at which kernels end on skins that are no grid, in widths: weights are below 0.003 of the largest there.
_REACH: Final = 3.5


def widths_for(surface: Surface) -> tuple[float, ...]:
    """Return the smoothing widths for a skin: up to a quarter of its shorter side, of its second longest extent."""
    side = min(surface.shape)
    if not surface.is_grid:
        centred = surface.positions_m - surface.positions_m.mean(axis=0)
        across_m = np.ptp(centred @ np.linalg.svd(centred, full_matrices=False)[2][1])
        side = round(float(across_m) / surface.pitch_m) + 1
    return tuple(width for width in WIDTHS if width <= side / 4) or WIDTHS[:1]


class Smoothed:
    """Energies and peaks of the adjoint image at several widths, without allocation per measurement.

    Parameters
    ----------
    phi : Phi
        Φ of shape (m, n).
    surface : Surface
        Of the skin.
    means : bool
        Whether sums of all taxels of a block count. Of neighbours they show where a force is; of taxels from all over
        the skin they show no place.

    Attributes
    ----------
    energies, peaks : float64, shape (widths,)
        Results of the newest `measure`: mean square and largest value of each smoothed image, in ADC counts.
    """

    def __init__(self, phi: Phi, surface: Surface, *, means: bool = False) -> None:
        widths = widths_for(surface)
        self.energies = np.zeros(len(widths))
        self.peaks = np.zeros(len(widths))
        if isinstance(phi, MatrixPhi):
            self._adjoint: _HadamardAdjoint | _MatrixAdjoint = _MatrixAdjoint(phi)
        elif isinstance(phi, Sbhe):
            self._adjoint = _HadamardAdjoint(phi, means=means)
        else:
            raise InputError(f"expected an Sbhe or a MatrixPhi, got {type(phi).__name__}")
        self._image = np.zeros(surface.shape, np.float32)
        self._stages = [
            _Stage(width, *surface.shape) if surface.is_grid else _ScatteredStage(width, surface) for width in widths
        ]

    def measure(self, sums: npt.NDArray[Any], valid: Float32, valid_ratio: float, cycle: int = 1) -> None:
        """Fill `energies` and `peaks` from one measurement.

        Parameters
        ----------
        sums : array, shape (m,)
            ADC counts or their means.
        valid : array of float32, shape (blocks,)
            1 or 0 per block; sums of invalid blocks count as 0.
        valid_ratio : float
            Mean of `valid`, above 0. The image is divided by its root, so the noise of the image is the same as
            without missing blocks.
        cycle : int
            Number of the cycle, from 1, of a Φ that changes.
        """
        self._adjoint.fill(self._image, sums, valid, valid_ratio, cycle)
        for index, stage in enumerate(self._stages):
            self.energies[index], self.peaks[index] = stage.measure(self._image)


class _HadamardAdjoint:
    """The weighted adjoint image of an SBHE."""

    def __init__(self, phi: Sbhe, *, means: bool) -> None:
        sums, taxels = phi.shape
        self._block_of_sum = np.ascontiguousarray(phi.block_of_sum)
        # The mean of ΦᵀΦ is (m / n) B I, so this weight gives taxels in counts.
        left_out = (phi.row_of_sum == 0) & (not means)
        self._weights = np.where(left_out, 0, taxels / (sums * phi.block_size)).astype(np.float32)
        # Rows that are not sent use the zero after the values.
        self._source = np.full(phi.kept.shape, sums, np.intp)
        self._source[phi.kept] = np.arange(sums)
        self._hadamard = fast_hadamard(np.eye(phi.block_size, dtype=np.float32)).astype(np.float32)
        self._places = phi.place_of_taxel
        self._is_wired = phi.is_wired.astype(np.float32)
        self._has_gaps = not phi.is_wired.all()
        self._padded = np.zeros(sums + 1, np.float32)
        self._values = self._padded[:sums]
        self._valid_sums = np.zeros(sums, np.float32)
        self._spread = np.zeros(phi.kept.shape, np.float32)
        self._scrambled = np.zeros(phi.kept.shape, np.float32)

    def fill(self, image: Float32, sums: npt.NDArray[Any], valid: Float32, valid_ratio: float, _cycle: int) -> None:
        """Write the image of sums, with the parameters of `Smoothed.measure`."""
        np.copyto(self._values, sums, casting="unsafe")
        self._values *= self._weights
        if valid_ratio < 1:
            np.take(valid, self._block_of_sum, out=self._valid_sums, mode="clip")
            self._values *= self._valid_sums
            self._values *= valid_ratio**-0.5
        np.take(self._padded, self._source, out=self._spread, mode="clip")
        np.matmul(self._spread, self._hadamard, out=self._scrambled)
        np.take(self._scrambled.reshape(-1), self._places, out=image.reshape(-1), mode="clip")
        if self._has_gaps:
            image *= self._is_wired.reshape(image.shape)


class _MatrixAdjoint:
    """The adjoint image of any matrix, without what a common offset of the taxels adds to the sums."""

    def __init__(self, phi: MatrixPhi) -> None:
        self._phi = phi
        #: As for an SBHE: taxels in counts.
        self._weight = phi.shape[1] * phi.frames / np.count_nonzero(phi.entries)

    def fill(self, image: Float32, sums: npt.NDArray[Any], valid: Float32, valid_ratio: float, cycle: int) -> None:
        """Write the image of sums, with the parameters of `Smoothed.measure`."""
        matrix = self._phi.of_cycle(cycle).dense
        values, common = valid * np.asarray(sums, np.float32), valid * matrix.sum(axis=1)
        if energy := float(common @ common):
            values -= common * np.float32(float(common @ values) / energy)
        np.matmul(values * np.float32(self._weight * valid_ratio**-0.5), matrix, out=image.reshape(-1))


class _Stage:
    """A Gaussian of unit energy, evaluated on a grid as coarse as its width allows."""

    def __init__(self, width: float, rows: int, columns: int) -> None:
        step = max(1, int(width / 2))
        self._left = _gaussian(width, rows, step)
        self._right = np.ascontiguousarray(_gaussian(width, columns, step).T)
        self._half = np.zeros((len(self._left), columns), np.float32)
        self._smooth = np.zeros((len(self._left), self._right.shape[1]), np.float32)
        self._flat = self._smooth.reshape(-1)

    def measure(self, image: Float32) -> tuple[float, float]:
        np.matmul(self._left, image, out=self._half)
        np.matmul(self._half, self._right, out=self._smooth)
        return float(np.dot(self._flat, self._flat)) / self._flat.size, float(self._flat.max())


class _ScatteredStage:
    """A Gaussian of the distance, of unit energy, at taxels as sparse as its width allows."""

    def __init__(self, width: float, surface: Surface) -> None:
        from scipy.sparse import csr_array  # no verb waits for SciPy that has no need of it
        from scipy.spatial import cKDTree

        places = surface.positions_m / surface.pitch_m
        centres = _thinned(np.hstack((places, width * surface.normals)), width / 2)
        pairs = cKDTree(places[centres]).sparse_distance_matrix(
            cKDTree(places), _REACH * width, output_type="coo_matrix"
        )
        centre, taxel = pairs.coords
        is_beside = (surface.normals[centres[centre]] * surface.normals[taxel]).sum(axis=1) > 0
        centre, taxel = centre[is_beside], taxel[is_beside]
        weights = np.exp(-(pairs.data[is_beside] ** 2) / (2 * width**2))
        # Each stands for the taxels around it, which a Gaussian of half the width shares out.
        shares = weights**4 / np.bincount(taxel, weights**4)[taxel]
        self._parts = (np.bincount(centre, shares) / len(places)).astype(np.float32)
        weights /= np.sqrt(np.bincount(centre, weights**2).max())
        self._kernel = csr_array((weights.astype(np.float32), (centre, taxel)), shape=(len(centres), len(places)))

    def measure(self, image: Float32) -> tuple[float, float]:
        smooth = self._kernel @ image.reshape(-1)
        return float(np.dot(self._parts, smooth * smooth)), float(smooth.max())


def _thinned(places: npt.NDArray[np.float64], least: float) -> npt.NDArray[np.intp]:
    """Return the numbers of places, in order, that are `least` or more from those before; all below a distance of 1."""
    from scipy.spatial import cKDTree

    tree, is_free, kept = cKDTree(places), np.ones(len(places), np.bool_), []
    for place in range(len(places)):
        if is_free[place]:
            kept.append(place)
            if least >= 1:
                is_free[tree.query_ball_point(places[place], 0.99 * least)] = False
    return np.array(kept, np.intp)


def _gaussian(width: float, size: int, step: int) -> Float32:
    places = np.arange(size)
    centres = places[(size - 1) % step // 2 :: step]
    kernel = np.exp(-((centres[:, None] - places) ** 2) / (2 * width**2))
    middle = kernel[len(centres) // 2]
    unit: Float32 = (kernel / np.linalg.norm(middle)).astype(np.float32)
    unit[unit < _LEAST_WEIGHT] = 0
    return unit
