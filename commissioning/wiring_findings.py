"""Which taxel is wired to which place, from the counts of all places while one finger goes over the skin.

A place counts most while the finger is on its taxel. So the counts of each place are compared with what a finger would
press on each taxel at the same moments: the place has the taxel that is most alike. The radius of the finger is that
with the best likeness.
"""

from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.chains import EMPTY
from skin.phi import Sbhe
from skin.surface import Floats, Indices, Surface

#: Moments that are needed for each taxel.
MOMENTS: Final = 4
#: Radius of a finger of usual size, in pitches, and those that are tried, on so many moments.
FINGER: Final = 2.5
FINGERS: Final = (1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0)
TRIED: Final = 2000
#: A finger is looked for within this distance of the likeliest taxel, in pitches, where it is at least as likely.
NEAR: Final = 1.6
LIKELY: Final = 0.7
#: Part of the largest force that a finger needs for a moment to count.
FELT: Final = 0.2
#: How much more of a finger the stroke must show than the noise before it.
TOUCHED: Final = 2.0
#: A place whose counts are less than this part of the usual response to its taxel feels nothing.
DEAD: Final = 0.3
#: What a likeness lacks of 1 must be this part of what that with the own taxel lacks for a place to be wired to
#: another, and this part of what that with a third taxel lacks for this to be sure.
OTHER: Final = 0.7
SURE: Final = 0.8
#: Part of the places of a board that must feel the taxels of another site for the board to sit there.
MOVED: Final = 0.5
#: Where the finger is estimated, its part of the squares of the counts, in all but a tenth of the moments.
EXPLAINED: Final = 0.7

#: What a place feels that feels no taxel, or one that the counts do not tell.
NOTHING: Final = -1
UNCLEAR: Final = -2

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
        ``moved``: a board sits where another should. ``unclear``: the counts do not tell where it is.
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


def findings_of(phi: Sbhe, surface: Surface, counts: Floats, path_m: Floats | None, rest: int) -> list[Finding]:
    """Find the taxels that are not wired as Φ says.

    Parameters
    ----------
    phi : Sbhe
        Of the layout.
    counts : array, shape (moments, blocks, block_size)
        Of all places, while the finger goes over the skin.
    path_m : array, shape (moments, 3), or None
        Where the finger is; None: somebody strokes the skin.
    rest : int
        Number of moments at the begin without touch.
    """
    if not 0 < rest < len(counts):
        raise InputError(f"expected a part without touch before the stroke, got {rest} of {len(counts)} moments")
    felt = counts.reshape(len(counts), -1).astype(np.float32)
    felt -= felt[:rest].mean(axis=0)
    noise = felt[:rest].std(axis=0)
    taxels, pitch_m = np.flatnonzero(phi.is_wired), surface.pitch_m
    own_place, places_m = phi.place_of_taxel[taxels], surface.positions_m[taxels]
    _, most = locate(felt[:, own_place], places_m, pitch_m, FINGER)
    top = np.quantile(most[rest:], 0.95)
    if top <= TOUCHED * most[:rest].max():
        raise InputError(f"expected a stroke after {rest} moments without touch: nothing touched the skin")
    is_touched = np.arange(len(counts)) >= rest
    if path_m is None:
        is_touched &= most >= FELT * top
    needed = MOMENTS * len(taxels)
    if is_touched.sum() < needed:
        raise InputError(
            f"expected {needed} moments with touch or more, {MOMENTS} for each taxel, got {is_touched.sum()}"
        )
    felt = felt[is_touched]
    given_m = None if path_m is None else path_m[is_touched]

    def pressed(radius: float, some: slice, is_right: npt.NDArray[Any] | float = 1.0) -> npt.NDArray[np.float32]:
        of_own = felt[some, own_place] * is_right
        known_m = locate(of_own, places_m, pitch_m, radius)[0] if given_m is None else given_m[some]
        return _scaled(_pressed(_away(known_m, places_m, pitch_m), radius), felt[some])

    some, every = slice(None, None, -(-len(felt) // TRIED)), slice(None)
    radius = max(FINGERS, key=lambda each: float(_likeness(felt[some], pressed(each, some)).max(axis=1).mean()))
    wired = _matched(felt, own_place, pressed(radius, every))
    if path_m is None:  # places that feel another taxel lead away from the finger
        made = pressed(radius, every, wired[own_place] == np.arange(len(taxels)))
        wired = _matched(felt, own_place, made)
        if np.quantile(_explained(felt[:, own_place], made, noise[own_place]), 0.1) < EXPLAINED:
            raise InputError(
                "cannot tell: the counts do not fit a finger where it seems to be. Boards may be exchanged, or more"
                " than one finger touched: give the path of the finger"
            )
    return _named(phi, np.where(wired >= 0, taxels[wired], wired))


def locate(felt: npt.NDArray[np.float32], places_m: Floats, pitch_m: float, radius: float) -> tuple[Floats, Floats]:
    """Return where a finger is at each moment, and how hard: where a finger of this radius makes the counts best.

    Parameters
    ----------
    felt : array, shape (moments, n)
        Counts of taxels above those without touch.
    places_m : array, shape (n, 3)
        Where the layout has the taxels.

    Returns
    -------
    path_m : array, shape (moments, 3)
    most : array, shape (moments,)
        In counts.
    """
    away = _away(places_m, places_m, pitch_m)
    finger = _pressed(away, radius)
    score = felt @ (finger / np.linalg.norm(finger, axis=1, keepdims=True)).T
    most = score.max(axis=1)
    weight = np.maximum(0.0, score / np.maximum(most, 1e-9)[:, None] - LIKELY) * (away <= NEAR)[score.argmax(axis=1)]
    path_m: Floats = weight @ places_m / np.maximum(weight.sum(axis=1, keepdims=True), 1e-9)
    return path_m, most


def _away(points_m: Floats, places_m: Floats, pitch_m: float) -> npt.NDArray[np.float32]:
    """Return the distances of points to the taxels, in pitches, shape (points, n)."""
    from scipy.spatial.distance import cdist

    away: npt.NDArray[np.float32] = (cdist(points_m, places_m) / pitch_m).astype(np.float32)
    return away


def _pressed(away: npt.NDArray[np.float32], radius: float) -> npt.NDArray[np.float32]:
    """Return what a finger presses on a taxel by its distance, of 1."""
    pressed: npt.NDArray[np.float32] = np.maximum(0.0, 1 - np.square(away / radius)).astype(np.float32)
    return pressed


def _scaled(pressed: npt.NDArray[np.float32], felt: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return what a finger presses at each moment as hard as the counts tell, shape (moments, n)."""
    strength = felt.sum(axis=1) / np.maximum(pressed.sum(axis=1), 1e-3)
    scaled: npt.NDArray[np.float32] = pressed * np.clip(strength, 0, 3 * np.median(strength))[:, None]
    return scaled


def _explained(
    felt: npt.NDArray[np.float32], pressed: npt.NDArray[np.float32], noise: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """Return which part of the squares of the counts is the finger's, at each moment, but for those of the noise."""
    squares = np.maximum(np.square(felt).sum(axis=1) - np.square(noise).sum(), 1e-9)
    explained: npt.NDArray[np.float32] = np.square((felt * pressed).sum(axis=1)) / (
        squares * np.maximum(np.square(pressed).sum(axis=1), 1e-9)
    )
    return explained


def _likeness(felt: npt.NDArray[np.float32], pressed: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return how alike the counts of each place are to what is pressed on each taxel, shape (places, n)."""
    lengths = [np.maximum(np.linalg.norm(each, axis=0), 1e-9) for each in (felt, pressed)]
    likeness: npt.NDArray[np.float32] = felt.T @ pressed / lengths[1] / lengths[0][:, None]
    return likeness


def _matched(felt: npt.NDArray[np.float32], own_place: Indices, pressed: npt.NDArray[np.float32]) -> Indices:
    """Return which taxel each place feels, shape (places,), `NOTHING` or `UNCLEAR`.

    Parameters
    ----------
    felt : array, shape (moments, places)
        Counts above those without touch.
    own_place : array of int, shape (n,)
        Place of each taxel by the layout.
    pressed : array, shape (moments, n)
        What the finger presses on each taxel.
    """
    likeness = _likeness(felt, pressed)
    places, best = np.arange(len(likeness)), likeness.argmax(axis=1)
    first, second = np.partition(likeness, -2, axis=1)[:, :-3:-1].T
    own = np.full(len(places), -1)
    own[own_place] = np.arange(len(own_place))
    is_other = (own < 0) | (1 - first < OTHER * (1 - likeness[places, own]))
    wired = np.where(is_other, best, own)
    felt_length, length = np.linalg.norm(felt, axis=0), np.linalg.norm(pressed, axis=0)
    response = likeness[places, wired] * felt_length / np.maximum(length[wired], 1e-9)
    usual = np.median(response[own_place])
    unclear: Indices = np.where(is_other & (1 - first > SURE * (1 - second)), UNCLEAR, wired)
    return np.where(response < DEAD * usual, NOTHING, unclear)


def _named(phi: Sbhe, wired: Indices) -> list[Finding]:
    """Return what the places feel where this is not what Φ says; `wired` is of `_matched`, in numbers of taxels."""
    size = phi.block_size
    moved = _moved(phi, wired)
    expected = phi.taxels_of_blocks.copy()
    expected[list(moved)] = phi.taxels_of_blocks[list(moved.values())]
    found = [Finding("moved", EMPTY, Place(board, 0), (Place(site, 0),)) for board, site in moved.items()]
    for place, taxel in enumerate(expected.ravel().tolist()):
        holders = np.flatnonzero(wired == taxel).tolist()
        if taxel >= phi.taxels or holders == [place]:
            continue
        is_unclear = len(holders) > 2 or (not holders and wired[place] == UNCLEAR)
        kind: Any = "unclear" if is_unclear else ("dead", "swapped", "doubled")[len(holders)]
        places = () if is_unclear else tuple(Place(*divmod(each, size)) for each in holders)
        found.append(Finding(kind, taxel, Place(*divmod(place, size)), places))
    return sorted(found, key=lambda each: (each.kind != "moved", each.expected))


def _moved(phi: Sbhe, wired: Indices) -> dict[int, int]:
    """Return the boards that sit where another should, and where."""
    moved = {}
    for board, felt in enumerate(wired.reshape(phi.blocks, -1)):
        sites = np.bincount(phi.place_of_taxel[felt[felt >= 0]] // phi.block_size, minlength=phi.blocks)
        site, taxels = int(sites.argmax()), np.count_nonzero(phi.taxels_of_blocks[board] < phi.taxels)
        if site != board and sites[site] > MOVED * taxels:
            moved[board] = site
    return moved
