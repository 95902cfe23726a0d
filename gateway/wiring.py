"""Which taxel is wired to which place, from what the boards tell while one finger goes over the skin.

The forces of a finger fall with the distance from its middle, by a profile that is fitted to the data. The sums are
then linear in the forces p(t): y(t) = A p(t), and the column a_i of A is what taxel i gives to every sum. With the
wiring of the layout A is Φ. What the sums show besides is explained by as few other a_i as possible (orthogonal
matching pursuit, Pati et al. 1993). Each of these a_i is then compared with the columns of all places: one place, two
places, or none.

Counts of taxels are sums, too: those of all Hadamard rows of a board. With fewer rows, two places whose signs are the
same in all sums of their board cannot be told apart.
"""

from dataclasses import dataclass, replace
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.chains import EMPTY
from skin.measurement import Sbhe, fast_hadamard
from skin.surface import Floats, Indices, Surface

#: The profile of the finger is linear between these distances, in pitches, and 0 from the last on.
KNOTS: Final = np.array([0.0, 0.7, 1.4, 2.1, 2.8, 3.5, 4.5, 6.0, 8.0])
#: Part of the squares of its signs by which a_i must change to be a finding.
LEAST_CHANGE: Final = 0.25
#: As `LEAST_CHANGE`, while the changes of neighbours still hide each other.
HINT: Final = 0.03
#: Deviations of the noise by which the square of this change must be larger than that of noise.
LEAST_SNR: Final = 4.0
#: Part of the difference of two explanations by which the better one must be nearer to the data.
LEAST_MARGIN: Final = 0.3
#: Taxels whose forces are more alike than this are not taken in one round of the pursuit.
ALIKE: Final = 0.3
#: Taxels whose forces are at least as alike as this are beside each other.
BESIDE: Final = 0.5
#: Most rounds of the pursuit.
ROUNDS: Final = 40
#: By how much the correlation of a board with another site must be better for the board to be moved.
MOVED: Final = 0.2
#: Part of the taxels with findings from which on an estimated path is wrong.
MANY: Final = 0.1
#: Least deviation of a sum, in counts: that of rounding.
LEAST_NOISE: Final = 0.3
#: Moments that are needed for each taxel.
MOMENTS: Final = 4
#: Corrections of a path that nobody knows, and the step of its slopes, in pitches.
SETTLING: Final = 4
STEP: Final = 0.2
#: Moments that are used for the profile, or at once.
FITTED: Final = 2000
#: Radius of a finger of usual size, in pitches.
FINGER: Final = 2.5
#: A finger is looked for within this distance of the likeliest taxel, in pitches, where it is at least as likely.
NEAR: Final = 1.6
LIKELY: Final = 0.7
#: Part of the largest force that a finger needs for a moment to count.
FELT: Final = 0.2
#: How much more of a finger the stroke must show than the noise before it.
TOUCHED: Final = 2.0

Kind = Literal["swapped", "dead", "doubled", "moved", "unclear"]


class Place(NamedTuple):
    """A place of a board."""

    board: int
    place: int


@dataclass(frozen=True)
class Finding:
    """What is not wired as the layout says.

    Attributes
    ----------
    kind : str
        ``swapped``: a taxel is on another place. ``dead``: no place feels it. ``doubled``: two places feel it.
        ``moved``: a board sits where another should. ``unclear``: what the boards tell does not say where it is.
    taxel : int
        -1 of a board.
    expected : Place
        Of the layout; of a board its number, and place 0.
    found : tuple of Place
        None of a dead or unclear taxel.
    """

    kind: Kind
    taxel: int
    expected: Place
    found: tuple[Place, ...] = ()


def counts_as_sums(phi: Sbhe, counts: npt.NDArray[Any]) -> tuple[Sbhe, Floats]:
    """Return counts of all places, shape (moments, blocks, block_size), as sums of all rows, and the Φ of these."""
    whole = replace(phi, kept=np.ones_like(phi.kept))
    return whole, np.asarray(fast_hadamard(counts.astype(np.float64))).reshape(len(counts), -1)


def prove(phi: Sbhe, surface: Surface, sums: Floats, path_m: Floats | None, rest: int) -> list[Finding]:
    """Find the taxels that are not wired as Φ says.

    Parameters
    ----------
    phi : Sbhe
        Of the layout, or of `counts_as_sums`.
    sums : array, shape (moments, m)
        While the finger goes over the skin.
    path_m : array, shape (moments, 3), or None
        Where the finger is; None: somebody strokes the skin.
    rest : int
        Number of moments at the begin without touch.
    """
    if not phi.has_sums.all():
        silent = np.flatnonzero(~phi.has_sums)[0]
        raise InputError(f"the board of block {silent} sends no sums: its wiring cannot be told")
    if not 0 < rest < len(sums):
        raise InputError(f"expected a part without touch before the stroke, got {rest} of {len(sums)} moments")
    noise = np.maximum(sums[:rest].std(axis=0), LEAST_NOISE)
    sums = sums - sums[:rest].mean(axis=0)
    some = slice(rest, None, 1 if path_m is None else -(-len(sums) // FITTED))
    found_m, most = locate(phi, surface, np.concatenate((sums[:rest], sums[some])))
    top = np.quantile(most[rest:], 0.95)
    if top <= TOUCHED * most[:rest].max():
        raise InputError(f"expected a stroke after {rest} moments without touch: nothing touched the skin")
    sums = sums[rest:]
    is_estimated = path_m is None
    if path_m is None:
        is_felt = most[rest:] >= FELT * top
        path_m, sums = found_m[rest:][is_felt], sums[is_felt]
        path_m = _settled(phi, surface, sums, path_m, noise)
    else:
        path_m = path_m[rest:]
    if len(sums) < MOMENTS * phi.is_wired.sum():
        least = MOMENTS * int(phi.is_wired.sum())
        raise InputError(f"expected {least} moments with touch or more, {MOMENTS} for each taxel, got {len(sums)}")
    sites = _sites(phi, _forces(phi, surface, sums, path_m, noise), sums)
    moved = [Finding("moved", EMPTY, Place(board, 0), (Place(site, 0),)) for board, site in sites.items()]
    if sites:  # with the boards in their places the finger is fitted anew
        chains = phi.taxels_of_blocks.copy()
        chains[list(sites)] = phi.taxels_of_blocks[list(sites.values())]
        phi = replace(phi, order=chains.ravel())
    force = _forces(phi, surface, sums, path_m, noise)
    found = _named(phi, *_pursue(phi, force - force.mean(axis=0), sums - sums.mean(axis=0), noise))
    if is_estimated and len(found) > MANY * phi.is_wired.sum():
        raise InputError(
            f"cannot tell: {len(found)} taxels do not fit where the finger seems to be. Boards may be exchanged, or"
            " more than one finger touched: give the path of the finger"
        )
    return moved + found


def _sites(phi: Sbhe, force: npt.NDArray[np.float32], sums: Floats) -> dict[int, int]:
    """Return the boards that sit where another should, and where: whose taxels explain their sums better."""
    from scipy.optimize import linear_sum_assignment

    some = slice(None, None, -(-len(sums) // FITTED))
    felt = phi.padded(force[some])[:, phi.taxels_of_blocks]
    like = np.zeros((phi.blocks, phi.blocks))
    signs = np.asarray(fast_hadamard(np.eye(phi.block_size)), np.float32)
    for board in np.flatnonzero(phi.has_sums).tolist():
        mine = sums[some, phi.starts[board] : phi.starts[board + 1]].astype(np.float32)
        made = felt @ signs[phi.rows_of(board)].T
        lengths = np.linalg.norm(made, axis=(0, 2)) * np.linalg.norm(mine)
        like[board] = np.einsum("tbr,tr->b", made, mine) / np.maximum(lengths, 1e-9)
    sites = linear_sum_assignment(-like)[1].tolist()
    return {board: site for board, site in enumerate(sites) if like[board, site] > like[board, board] + MOVED}


def _settled(phi: Sbhe, surface: Surface, sums: Floats, path_m: Floats, noise: Floats) -> Floats:
    """Move each point of a path to where the finger fits its sums best (Gauss and Newton)."""
    for _ in range(SETTLING):
        force = _forces(phi, surface, sums, path_m, noise)
        left = sums - np.asarray(phi.forward(force))
        slopes = []
        for axis in np.eye(3) * STEP * surface.pitch_m:
            aside = _forces(phi, surface, sums, path_m + axis, noise)
            slopes.append(np.asarray(phi.forward(aside - force)) / STEP)
        slope = np.stack(slopes, axis=1)
        gram = slope @ slope.transpose(0, 2, 1)
        gram += 1e-2 * np.trace(gram, axis1=1, axis2=2).mean() * np.eye(3)
        step = np.linalg.solve(gram, (slope @ left[:, :, None]))[:, :, 0]
        path_m = path_m + np.clip(step, -0.5, 0.5) * surface.pitch_m
    return path_m


def _forces(phi: Sbhe, surface: Surface, sums: Floats, path_m: Floats, noise: Floats) -> npt.NDArray[np.float32]:
    """Return the force of every taxel at each moment, shape (moments, n): profile and strength fitted to the sums."""
    some = slice(None, None, -(-len(sums) // FITTED))
    away = _away(surface, path_m)
    energy = np.maximum(np.square(sums).sum(axis=1) - np.square(noise).sum(), 0.0)
    of_parts = np.stack([_felt(phi, np.interp(away[some], KNOTS, part)) for part in np.eye(len(KNOTS))[:-1]])
    strength = np.ones(of_parts.shape[1], np.float32)
    for _ in range(3):
        scaled = (of_parts * strength[:, None]).reshape(len(of_parts), -1)
        gram, told = scaled @ scaled.T, scaled @ sums[some].astype(np.float32).ravel()
        profile = np.linalg.lstsq(gram + 1e-6 * np.trace(gram) * np.eye(len(gram)), told, rcond=None)[0]
        strength = _strength(np.square(np.tensordot(profile, of_parts, 1)).sum(axis=1), energy[some])
    force = np.interp(away, KNOTS, np.append(profile, 0.0)).astype(np.float32) * phi.is_wired
    strength = _strength(np.square(np.asarray(phi.forward(force))).sum(axis=1), energy)
    scaled_force: npt.NDArray[np.float32] = force * strength[:, None]
    return scaled_force


def _felt(phi: Sbhe, force: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    return np.asarray(phi.forward((force * phi.is_wired).astype(np.float32)), np.float32)


def _strength(made: npt.NDArray[Any], energy: Floats) -> npt.NDArray[np.float32]:
    """Return how hard the finger presses, of the energy that its profile makes and of that of the sums."""
    strength = np.sqrt(energy / np.maximum(made, 1e-3 * made.max()))
    limited: npt.NDArray[np.float32] = np.minimum(strength, 3 * np.median(strength)).astype(np.float32)
    return limited


def _away(surface: Surface, points_m: Floats) -> npt.NDArray[np.float32]:
    """Return the distances of points to the taxels, in pitches, shape (points, n)."""
    from scipy.spatial.distance import cdist

    away: npt.NDArray[np.float32] = (cdist(points_m, surface.positions_m) / surface.pitch_m).astype(np.float32)
    return away


def locate(phi: Sbhe, surface: Surface, sums: Floats) -> tuple[Floats, Floats]:
    """Return where a finger is at each moment, and how hard: where a finger of usual size makes the sums best.

    Returns
    -------
    path_m : array, shape (moments, 3)
    most : array, shape (moments,)
        In counts.
    """
    wired = np.flatnonzero(phi.is_wired)
    places_m = surface.positions_m[wired]
    finger = np.maximum(0.0, 1 - np.square(_away(surface, places_m) / FINGER))
    of_places = _felt(phi, finger)
    of_places /= np.linalg.norm(of_places, axis=1, keepdims=True)
    near = _away(surface, places_m)[:, wired] <= NEAR
    path_m, most = np.empty((len(sums), 3)), np.empty(len(sums))
    for begin in range(0, len(sums), FITTED):
        score = sums[begin : begin + FITTED].astype(np.float32) @ of_places.T
        most[begin : begin + FITTED] = top = score.max(axis=1)
        weight = np.maximum(0.0, score / np.maximum(top, 1e-9)[:, None] - LIKELY) * near[score.argmax(axis=1)]
        path_m[begin : begin + FITTED] = weight @ places_m / np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
    return path_m, most


def _pursue(phi: Sbhe, force: npt.NDArray[np.float32], sums: Floats, noise: Floats) -> tuple[Indices, Floats]:
    """Return the taxels that do not give what Φ says, and what they give to every sum, shape (taxels, m)."""
    rest = (sums - np.asarray(phi.forward(force))).astype(np.float32)
    # Without touch, converters that end at 0 show half of the noise.
    noise = np.clip(1.4826 * np.median(np.abs(rest), axis=0), noise, 2 * noise)
    alike, told = force.T @ force, force.T @ rest
    power = np.diag(alike)
    rows = np.maximum(np.diff(phi.starts), 1)
    has_power = phi.is_wired & (power > 1e-3 * power.max())
    safe = np.where(has_power, power, 1.0)

    def changes(
        given: npt.NDArray[Any], spread: npt.NDArray[Any], least: float
    ) -> tuple[Floats, npt.NDArray[np.bool_]]:
        """Return the largest change of any board's sums by taxel, in parts of its squares, and whether it is news.

        `spread` is the variance of what a taxel gives, in that of the sums.
        """
        squares = np.square(given)
        of_noise = np.add.reduceat(squares / np.square(noise), phi.starts[:-1], axis=1) / spread[:, None]
        parts = np.add.reduceat(squares, phi.starts[:-1], axis=1) / rows
        is_news = (parts >= least) & ((of_noise - rows) / np.sqrt(2 * rows) >= LEAST_SNR)
        return np.where(is_news, parts, 0).max(axis=1), is_news.any(axis=1)

    support, given = np.zeros(0, np.intp), np.zeros((0, sums.shape[1]))
    for _ in range(ROUNDS):
        left = told - alike[:, support] @ given.astype(np.float32)
        size, is_news = changes(left / safe[:, None], 1 / safe, HINT)
        is_news[support] = False
        is_news &= has_power
        new: list[int] = []
        for taxel in np.argsort(-size * power * is_news)[: int(is_news.sum())].tolist():
            close = np.abs(alike[taxel, new]) / np.sqrt(power[taxel] * power[new])
            if not new or close.max() < ALIKE:
                new.append(taxel)
        if not new:
            break
        support = np.concatenate((support, new)).astype(np.intp)
        given, _ = _solve(alike, told, support)
    # A taxel may stand for its neighbour: with the neighbours beside it, each explains its own part.
    likeness = np.abs(alike[support]) / np.sqrt(safe[support, None] * safe)
    support = np.flatnonzero((likeness >= BESIDE).any(axis=0) & has_power) if support.size else support
    if not support.size:
        return support, np.zeros((0, sums.shape[1]))
    given, spread = _solve(alike, told, support)
    is_news = changes(given, spread, LEAST_CHANGE)[1]
    given, _ = _solve(alike, told, support[is_news])
    support = support[is_news]
    return support, given + _columns(phi, support)


def _solve(alike: npt.NDArray[np.float32], told: npt.NDArray[Any], support: Indices) -> tuple[Floats, Floats]:
    """Return what the taxels of a support give to every sum, by least squares, and its variance in that of the sums."""
    of_support = alike[np.ix_(support, support)].astype(np.float64)
    inverse = np.linalg.inv(of_support + 1e-4 * np.diag(np.diag(of_support)))
    return inverse @ told[support], np.diag(inverse)


def _columns(phi: Sbhe, taxels: Indices) -> Floats:
    """Return the columns of Φ of some taxels, shape (taxels, m)."""
    ones = np.zeros((len(taxels), phi.taxels))
    ones[np.arange(len(taxels)), taxels] = 1
    return np.asarray(phi.forward(ones), np.float64)


def _explain(phi: Sbhe, given: Floats, expected: int) -> tuple[int, ...] | None:
    """Return the places (numbers of all boards) that explain what a taxel gives to every sum; None if unclear."""
    size, signs = phi.block_size, fast_hadamard(np.eye(phi.block_size))
    rows = np.maximum(np.diff(phi.starts), 1)
    parts = np.add.reduceat(np.square(given), phi.starts[:-1], axis=0) / rows
    boards = np.union1d(np.argsort(-parts)[:3][np.sort(parts)[::-1][:3] >= LEAST_CHANGE], expected // size)
    there = np.isin(phi.block_of_sum, boards)
    given = given[there]
    block, row = phi.block_of_sum[there], phi.row_of_sum[there]
    places = (boards[:, None] * size + np.arange(size)).ravel()
    columns = np.where(places[:, None] // size == block, signs[row][:, places % size].T, 0.0)
    one = np.arange(len(places))
    first, second = np.triu_indices(len(places), 1)
    shapes = np.concatenate([np.zeros((1, given.size)), columns, columns[first] + columns[second]])
    named: list[tuple[int, ...]] = [(), *((int(places[each]),) for each in one)]
    named += [(int(places[a]), int(places[b])) for a, b in zip(first, second, strict=True)]
    price = np.concatenate([[0.0], np.full(len(one), 0.2), np.full(len(first), 0.6)]) * rows[boards].mean()
    error = np.square(shapes - given).sum(axis=1)
    has_own = np.array([expected in each for each in named])
    cost = error + price - 0.1 * rows[boards].mean() * has_own
    best = int(np.argmin(cost))
    apart = np.square(shapes - shapes[best]).sum(axis=1)
    same = (apart == 0) & (np.array([len(each) for each in named]) == len(named[best]))
    if same.sum() > 1 and (not has_own[best] or (same & has_own).sum() > 1):
        return None
    others = apart > 0
    margin = (error[others] - error[best]) / apart[others]
    if others.any() and margin.min() < LEAST_MARGIN:
        # What may be as it should be is no finding.
        own = named.index((expected,))
        return (expected,) if error[own] - error[best] < LEAST_MARGIN * apart[own] else None
    return named[best]


def _named(phi: Sbhe, taxels: Indices, given: Floats) -> list[Finding]:
    """Return what the taxels are wired to, where this is not what Φ says."""
    size, kinds = phi.block_size, ("dead", "swapped", "doubled")
    found: list[Finding] = []
    for taxel, each in zip(taxels.tolist(), given, strict=True):
        expected = int(phi.place_of_taxel[taxel])
        places = _explain(phi, each, expected)
        if places != (expected,):
            kind: Any = "unclear" if places is None else kinds[len(places)]
            found.append(
                Finding(
                    kind, taxel, Place(*divmod(expected, size)), tuple(Place(*divmod(p, size)) for p in places or ())
                )
            )
    return sorted(found, key=lambda each: each.expected)
