"""Random wiring errors of a skin, and what is found of them."""

from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import tomli_w
from scipy.spatial.distance import cdist

from commissioning.wiring_findings import MOMENTS, Finding, findings_of
from skin.layout import Layout, load_layout, parse_layout
from skin.phi import Sbhe
from skin.sources import Frame
from skin.surface import Floats, Indices
from skin.taxel import NOISE_N

KINDS: Final = ("none", "swapped", "dead", "doubled", "moved")
#: Moments without touch at the begin.
REST: Final = 20
#: Of the finger: radius in pitches, and force where it presses hardest.
RADIUS: Final = 2.5
FORCE_N: Final = 0.015


def layout_of(name: str) -> Layout:
    """Return a layout by name; `cone` is a part of a cone of 230 taxels at positions."""
    if name != "cone":
        return load_layout(Path(name))
    row, column = np.divmod(np.arange(230), 23)
    radius_m, angle = 0.04 + 0.0008 * row, column * 0.16
    places = np.stack((radius_m * np.cos(angle), radius_m * np.sin(angle), 0.007 * row), axis=1)
    text = tomli_w.dumps({"taxels": {"positions": places.tolist(), "force_max_n": 0.02}})
    return parse_layout(text.encode(), "cone.toml")


def stroke(
    layout: Layout, phi: Sbhe, random: np.random.Generator, passes: int
) -> tuple[Floats, npt.NDArray[np.float32]]:
    """Return where a finger is that goes to every taxel in `passes` passes, and the forces, shape (moments, n)."""
    surface = layout.taxels.surface
    places_m = np.tile(surface.positions_m[phi.is_wired], (passes, 1))
    aside_m = random.uniform(-0.3, 0.3, places_m.shape) * surface.pitch_m * (1, 1, not surface.is_flat)
    path_m = np.concatenate((np.zeros((REST, 3)), places_m + aside_m))
    return path_m, pressed(layout, phi, path_m) * random.uniform(0.8, 1.2, (len(path_m), 1)).astype(np.float32)


def pressed(layout: Layout, phi: Sbhe, path_m: Floats) -> npt.NDArray[np.float32]:
    """Return the forces of a finger on a path that begins with `REST` moments without touch, shape (moments, n)."""
    surface = layout.taxels.surface
    away = cdist(path_m, surface.positions_m) / surface.pitch_m
    force_n = FORCE_N * np.maximum(0, 1 - np.square(away / RADIUS))
    force_n[:REST], force_n[:, ~phi.is_wired] = 0, 0
    return force_n.astype(np.float32)


class Finger:
    """A source of the touches of a finger."""

    has_noise = False
    step = 0

    def __init__(self, layout: Layout, path_m: Floats, force_n: npt.NDArray[np.float32]) -> None:
        self.path_m, self._force_n = path_m, force_n
        self._shape = layout.taxels.rows, layout.taxels.columns

    def frame(self, step: int) -> Frame:
        """Return the touch at a step; the last one stays."""
        self.step = min(max(step, 0), len(self._force_n) - 1)
        return Frame(self._force_n[self.step].reshape(self._shape), "")


def wired(phi: Sbhe, kind: str, random: np.random.Generator) -> tuple[Indices, set[tuple[object, ...]]]:
    """Return the taxel that is wired to each place, -1 for none, and what is to be found."""
    order = phi.taxels_of_blocks.copy()
    places = [tuple(map(int, each)) for each in np.argwhere(order < phi.taxels)]
    first = places[random.integers(len(places))]
    same_board = kind == "doubled" or random.random() < 0.5
    others = [each for each in places if each != first and (each[0] == first[0] or not same_board)]
    second = others[random.integers(len(others))]
    one, other = int(order[first]), int(order[second])
    if kind == "swapped":
        order[first], order[second] = other, one
        return order, {("swapped", one, second), ("swapped", other, first)}
    if kind == "dead":
        order[first] = -1
        return order, {("dead", one)}
    if kind == "doubled":
        order[second] = one
        return order, {("doubled", one, *sorted((first, second))), ("dead", other)}
    if kind == "moved":
        a, b = map(int, random.choice(len(order), 2, replace=False))
        order[[a, b]] = order[[b, a]]
        return order, {("moved", -1, (b, 0)), ("moved", -1, (a, 0))}
    return order, set()


def measured(layout: Layout, phi: Sbhe, order: Indices, force_n: npt.NDArray[np.float32], random: Any) -> Floats:
    """Return the counts of all places, shape (moments, boards, places)."""
    taxels = layout.taxels
    padded_n = np.concatenate((force_n, np.zeros((len(force_n), 1), np.float32)), axis=1)
    felt_n = padded_n[:, np.where((order < 0) | (order >= phi.taxels), phi.taxels, order)]
    felt_n += NOISE_N * random.standard_normal(felt_n.shape, np.float32) * (phi.taxels_of_blocks < phi.taxels)
    return np.clip(np.rint(felt_n / taxels.newton_per_count), 0, taxels.count_max)


def told(finding: Finding) -> tuple[object, ...]:
    """Return a finding as `wired` names it."""
    found = sorted(map(tuple, finding.found))
    return (finding.kind, finding.taxel, *found)


def found_of(
    layout: Layout, kind: str, seed: int, *, knows_path: bool = True
) -> tuple[set[tuple[object, ...]], set[tuple[object, ...]]]:
    """Return what is wrong on a skin with one wiring error, and what is found."""
    random, phi = np.random.default_rng(seed), layout.phi()
    path_m, force_n = stroke(layout, phi, random, MOMENTS + 2 * (not knows_path))
    order, wrong = wired(phi, kind, random)
    counts = measured(layout, phi, order, force_n, random)
    findings = findings_of(phi, layout.taxels.surface, counts, path_m if knows_path else None, REST)
    return wrong, {told(each) for each in findings}
