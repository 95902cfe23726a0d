"""The gain of every taxel, and of every analogue sum, from a known weight that was rolled over the skin.

The weight is round where it touches, and its contact does not change while it rolls: so its profile over the distance
from the centre is the mean over all images, in which gains cancel. With the profile at each centre, scaled to the known
force, the forces f of a cycle are known, and the sums are y = Φ diag(f) g. Block by block the gains g are the least
squares solution, pulled towards 1 where a taxel was hardly touched.

The sums of an analogue front end have gains D and C, too (`skin.defects.SumGains`): y = (D H + C H_0) diag(f) g. The
gains g of the taxels and D and C of the sums of a block are found together, by the method of Gauss and Newton, pulled
towards 1, 1 and 0.
"""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.distance import cdist

from calibration.windows import Bools, Floats
from canskin.errors import InputError
from skin.defects import SumGains
from skin.frontend import LEAST_FELT, felt_by_sums, with_gains
from skin.phi import Sbhe, fast_hadamard
from skin.surface import Surface

#: A contact is what is above this part of an image's largest force.
CONTACT_PART: Final = 0.05
#: Width of a ring of the profile, and how far the profile goes beyond the mean contact, pitches.
RING: Final = 0.25
BEYOND: Final = 2.0
#: Deviation of gains before they are measured.
SPREAD: Final = 0.1
#: The same of gains of sums. A common factor of a block's taxels is one of its sums, too: most of it is given to the
#: taxels, whose gains deviate more.
SUM_SPREAD: Final = 0.02
#: Gains are found and taken off the images, once more: centres and profile are better then.
PASSES: Final = 2
#: Steps of Gauss and Newton in a pass.
STEPS: Final = 3
#: What the weight tells of a known gain over what `SPREAD` tells, at least.
LEAST_RATIO: Final = 25.0
#: Fewest cycles with the whole weight on the skin.
LEAST_CYCLES: Final = 100
#: Cycles that are worked on at the same time.
_PART: Final = 128

Images = npt.NDArray[np.floating]


class Gains(NamedTuple):
    """Gains of taxels.

    Attributes
    ----------
    gains : array, shape (n,)
        Reading / force, row-major; 1 where not known.
    known : array of bool, shape (n,)
        Taxels that the weight rolled over.
    cycles : int
        Cycles that were used: those with the whole weight on the skin.
    sums : SumGains, optional
        Of an analogue front end.
    """

    gains: Floats
    known: Bools
    cycles: int
    sums: SumGains | None = None


def find_gains(
    phi: Sbhe, surface: Surface, sums_n: Floats, images_n: Images, force_n: float, *, is_analogue: bool = False
) -> Gains:
    """Return the gains of all taxels; raise InputError if the whole weight was on the skin in too few cycles.

    Parameters
    ----------
    sums_n : array, shape (cycles, m)
        Sums less their offsets, newtons; all of them valid.
    images_n : array, shape (cycles, n) or (cycles, rows, columns)
        The images of these sums.
    force_n : float
        The weight's force.
    is_analogue : bool
        Sums have gains, too.
    """
    gains = np.ones(phi.shape[1])
    known = np.zeros(phi.shape[1], np.bool_)
    of_sums = SumGains(np.ones(phi.shape[0]), np.zeros(phi.shape[0])) if is_analogue else None
    cycles, border, places = 0, surface.is_border, surface.positions_m / surface.pitch_m
    for _ in range(PASSES):
        felt_n = images_n.reshape(len(images_n), -1) / gains
        contact = _contact(felt_n)
        whole = np.flatnonzero(contact.any(axis=1) & ~contact[:, border].any(axis=1))
        cycles = whole.size
        if cycles < LEAST_CYCLES:
            raise InputError(
                f"the whole weight is on the skin in {cycles} cycles, expected {LEAST_CYCLES} or more, with nothing"
                " else: roll it slowly over all of the skin"
            )
        forces_n = _forces(felt_n[whole], places, force_n)
        if of_sums is None:
            gains, known = _solved(phi, sums_n[whole], forces_n, gains)
            continue
        gains, known, of_sums = _solved_with_sums(phi, sums_n[whole], forces_n, gains, of_sums)
    return Gains(gains, known, cycles, of_sums)


def defects_of(found: Gains, phi: Sbhe, surface: Surface) -> list[str]:
    """Return the taxels and sums that feel little or nothing, in words."""
    weak = np.flatnonzero(found.known & (found.gains < LEAST_FELT))
    words = [f"{surface.name_of(taxel)} feels {max(0.0, found.gains[taxel]):.0%}" for taxel in weak.tolist()]
    if found.sums is not None:
        felt = felt_by_sums(phi, found.sums)
        words += [
            f"sum {each} (block {phi.block_of_sum[each]}, row {phi.row_of_sum[each]}) feels {max(0.0, felt[each]):.0%}"
            " and is not used"
            for each in np.flatnonzero(felt < LEAST_FELT).tolist()
        ]
    return words


def _contact(images_n: Images) -> Bools:
    contact: Bools = images_n > CONTACT_PART * images_n.max(axis=1, keepdims=True)
    return contact


def _forces(images_n: Images, places: Floats, force_n: float) -> npt.NDArray[np.float32]:
    """Return the forces of a round weight at the centre of each image, shape (cycles, n).

    `places` are the positions of the taxels in pitches.
    """
    contact = _contact(images_n)
    radius = float(np.sqrt(contact.sum() / len(contact) / np.pi)) + BEYOND
    rings = int(np.ceil(radius / RING))
    total, count = np.zeros((2, rings))
    parts = [slice(begin, begin + _PART) for begin in range(0, len(images_n), _PART)]
    pressed_n = (np.where(contact[part], images_n[part], 0) for part in parts)
    centres = np.concatenate([each_n @ places / each_n.sum(axis=1, keepdims=True) for each_n in pressed_n])
    for part in parts:
        ring = (cdist(centres[part], places) / RING).astype(np.intp)
        inside = ring < rings
        total += np.bincount(ring[inside], images_n[part][inside], rings)
        count += np.bincount(ring[inside], minlength=rings)
    profile_n = total / np.maximum(count, 1)
    middles = (np.arange(rings) + 0.5) * RING
    forces_n = np.empty(images_n.shape, np.float32)
    for part in parts:
        shape_n = np.interp(cdist(centres[part], places), middles, profile_n, right=0.0)
        forces_n[part] = shape_n * (force_n / shape_n.sum(axis=1, keepdims=True))
    return forces_n


def _solved(phi: Sbhe, sums_n: Floats, forces_n: npt.NDArray[np.float32], before: Floats) -> tuple[Floats, Bools]:
    """Return the gains by least squares, and which are known; `before` are those of the pass before."""
    residual: Floats = sums_n - np.asarray(phi.forward(forces_n * before.astype(np.float32)), np.float64)
    pull = float(np.mean(np.square(residual, dtype=np.float64))) / SPREAD**2
    gains, known = np.ones(phi.shape[1]), np.zeros(phi.shape[1], np.bool_)
    for block in range(phi.blocks):
        taxels, signs = _signs(phi, block)
        mine_n = forces_n[:, taxels].astype(np.float64)
        normal = (mine_n.T @ mine_n) * (signs.T @ signs)
        right = (mine_n * (sums_n[:, phi.starts[block] : phi.starts[block + 1]] @ signs)).sum(axis=0)
        known[taxels] = np.diag(normal) > LEAST_RATIO * pull
        gains[taxels] = np.linalg.solve(normal + pull * np.eye(len(taxels)), right + pull)
    gains[~known] = 1.0
    return gains, known


def _signs(phi: Sbhe, block: int) -> tuple[npt.NDArray[np.intp], Floats]:
    """Return the taxels of a block, shape (k,), and their signs in its sums, shape (sums of the block, k)."""
    rows = np.asarray(fast_hadamard(np.eye(phi.block_size)), np.float64)[phi.kept[block]]
    return phi.taxels_of(block), rows[:, phi.taxels_of_blocks[block] < phi.shape[1]]


def _solved_with_sums(
    phi: Sbhe, sums_n: Floats, forces_n: npt.NDArray[np.float32], before: Floats, of_sums: SumGains
) -> tuple[Floats, Bools, SumGains]:
    """Return the gains of taxels, which of them are known, and those of sums: Gauss-Newton steps, block by block."""
    read_n = forces_n * before.astype(np.float32)
    expected_n = with_gains(phi, read_n, np.asarray(phi.forward(read_n), np.float32), of_sums)
    pull = float(np.mean(np.square(sums_n - expected_n, dtype=np.float64))) / SPREAD**2
    gains, known = before.copy(), np.zeros(phi.shape[1], np.bool_)
    differential, common_mode = of_sums.differential.copy(), of_sums.common_mode.copy()
    for block in range(phi.blocks):
        taxels, signs = _signs(phi, block)
        mine = slice(phi.starts[block], phi.starts[block + 1])
        force_n = forces_n[:, taxels].astype(np.float64)
        model = _BlockGains(gains[taxels], differential[mine], common_mode[mine], signs)
        power, seen = force_n.T @ force_n, force_n.T @ sums_n[:, mine]
        for _ in range(STEPS):
            model, certain = model.nearer(power, seen, pull)
        gains[taxels], differential[mine], common_mode[mine] = model[:3]
        known[taxels] = certain > LEAST_RATIO * pull
    gains[~known] = 1.0
    return gains, known, SumGains(differential, common_mode)


class _BlockGains(NamedTuple):
    """Gains of the taxels (B,) and sums (K,) of a block, and the signs (K, B): y_k = Σ (D_k s_k + C_k) g f."""

    taxels: Floats
    differential: Floats
    common_mode: Floats
    signs: Floats

    def nearer(self, power: Floats, seen: Floats, pull: float) -> tuple["_BlockGains", Floats]:
        """Return the gains after a Gauss-Newton step, and what is known of each taxel's.

        Parameters
        ----------
        power : array, shape (B, B)
            fᵀf of the forces f, shape (cycles, B).
        seen : array, shape (B, K)
            fᵀy of the sums y.
        pull : float
            Weight of gains of 1 and 0.
        """
        size, sums = self.taxels.size, self.differential.size
        weights = self.differential[:, None] * self.signs + self.common_mode[:, None]
        left = seen - power @ (weights * self.taxels).T
        # (sums, taxels, unknowns): how the weight of each taxel in each sum changes with the unknowns.
        change = np.zeros((sums, size, size + 2 * sums))
        of_sum = np.arange(sums)
        change[:, np.arange(size), np.arange(size)] = weights
        change[of_sum, :, size + of_sum] = self.signs * self.taxels
        change[of_sum, :, size + sums + of_sum] = self.taxels
        normal = np.einsum("kti,tu,kuj->ij", change, power, change, optimize=True)
        right = np.einsum("kti,tk->i", change, left)
        unknown = np.concatenate([self.taxels - 1, self.differential - 1, self.common_mode])
        pulls = pull * np.repeat([1.0, (SPREAD / SUM_SPREAD) ** 2], [size, 2 * sums])
        step = np.linalg.solve(normal + np.diag(pulls), right - pulls * unknown)
        taxels, differential, common_mode = np.split(unknown + step, [size, size + sums])
        return _BlockGains(1 + taxels, 1 + differential, common_mode, self.signs), np.diag(normal)[:size]
