"""``skin evaluate contacts``: centre, force and identity of the contacts of known touches, beside the truth."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import ndimage

from canskin.messages import Contact
from dbc.contract import Contract
from evaluation.result import Options, Result, Row
from evaluation.result_cache import measure_cells
from evaluation.schemes.scenes import SIDE, Touch
from evaluation.schemes.sums import run_sums
from reconstructor.contacts import ONSET_N, ContactTracker
from skin.layout import Taxels, load_layout
from skin.sources import object_label
from skin.taxel import to_counts
from touch.contact import Force, Grid, Pose, press
from touch.objects import spheres_of
from touch.trajectory import PAPER_DEPTH_M, PAPER_PRESS_STEPS, trajectory

#: Two balls that slide against each other and part.
MEETING: Final = "two balls meet and part"
TICKS: Final = 2000
QUICK_TICKS: Final = 1400
#: The balls are pressed in until then; the paper's objects, until `PAPER_PRESS_STEPS`.
MEETING_PRESS_TICKS: Final = 300
#: Where the balls begin and how near they come, metres from the middle of the skin.
MEETING_FAR_M: Final = 0.06
MEETING_NEAR_M: Final = 0.026
_EIGHT: Final = np.ones((3, 3))


@dataclass(frozen=True)
class _Truth:
    """True forces, float32, shape (ticks, SIDE, SIDE), and those of each region: of an object, or of a foot of it."""

    force_n: Force
    objects: list[Force]

    def regions(self, tick: int) -> list[Force]:
        """Return the force of every touched region of a moment."""
        found = []
        for force_n in self.objects:
            labels, count = ndimage.label(force_n[tick] > 0, _EIGHT)
            feet = (np.where(labels == foot, force_n[tick], 0) for foot in range(1, count + 1))
            found += [foot for foot in feet if foot.max() > ONSET_N]
        return found


def evaluate(options: Options) -> Result:
    """Follow the contacts of the paper's slides, of two balls that meet, and of nothing.

    Parameters
    ----------
    options : Options
        `quick` looks at one slide.
    """
    names = [options.objects[0]] if options.quick else [*options.objects, MEETING, "nothing"]
    ticks = QUICK_TICKS if options.quick else TICKS
    cells = [{"name": name, "ticks": ticks, **options.shared} for name in names]
    rows = measure_cells(measure_contacts, cells, options, "contacts")
    return Result(
        "Contacts of the default skin: centre in pitches, force / true force - 1, identities",
        [{"touch": object_label(name), **row} for name, row in zip(names, rows, strict=True)],
        note="A cycle counts for centre and force when the touch has been pressed in and the number of contacts is"
        " that of the touched regions.",
    )


def measure_contacts(name: str, ticks: int, meshes: str | None, seed: int) -> Row:
    """Return the errors of the contacts of a touch, in cycles of the default skin.

    Returns
    -------
    dict
        ``regions``, the most that touch at a time; ``right_number``, part of the cycles with as many contacts;
        medians and 95 % quantiles of the errors; ``identities`` that were given; ``ended``; ``image_us``, the median
        time for one image.
    """
    truth = _truth(name, ticks, meshes)
    contract = Contract.from_layout(load_layout())
    touch = Touch("nothing", seed=seed)
    felt_n = touch.sensed(truth.force_n.reshape(ticks, -1), np.random.default_rng(seed))
    counts = to_counts(felt_n, Taxels()).astype(np.int16)
    images = run_sums(contract, counts, idle_counts=touch.idle()).images(contract).force_n
    tracker, period_ms = ContactTracker(contract.layout.taxels.surface), round(1e3 / contract.layout.sync.rate_hz)
    tracker.warm_up()
    errors: list[tuple[float, float]] = []
    times_s, counted, ended, identities, right = [], [], 0, set(), 0
    for cycle, image in enumerate(images):
        started_s = time.perf_counter()
        contacts, gone = tracker.take(image.reshape(SIDE, SIDE), cycle * period_ms * 1_000_000)
        times_s.append(time.perf_counter() - started_s)
        regions = truth.regions(cycle * period_ms)
        counted.append(len(regions))
        right += len(regions) == len(contacts)
        identities |= {each.identity for each in contacts}
        ended += len(gone)
        if cycle * period_ms >= _pressed_in(name) and len(regions) == len(contacts):
            errors += [_errors(contact, regions) for contact in contacts]
    centre, force = np.array(errors).T if errors else np.full((2, 1), np.nan)
    return {
        "regions": max(counted),
        "right_number": right / len(images),
        "centre_median": _rounded(np.median(centre)),
        "centre_95": _rounded(np.quantile(centre, 0.95)),
        "force_median": _rounded(np.median(force)),
        "force_95": _rounded(np.quantile(np.abs(force), 0.95)),
        "identities": len(identities),
        "ended": ended,
        "image_us": round(1e6 * float(np.median(times_s))),
    }


def _rounded(value: np.floating) -> float | None:
    return round(float(value), 3) if math.isfinite(value) else None


def _errors(contact: Contact, regions: list[Force]) -> tuple[float, float]:
    """Return distance to the nearest true centre in pitches, and relative error of its force."""
    centres = [ndimage.center_of_mass(region) for region in regions]
    distances = [math.hypot(row - contact.row, column - contact.column) for row, column in centres]
    nearest = distances.index(min(distances))
    return distances[nearest], contact.force_n / float(regions[nearest].sum()) - 1


def _pressed_in(name: str) -> int:
    """Return the tick from which on an object is pressed in as deep as it will be."""
    return MEETING_PRESS_TICKS if name == MEETING else PAPER_PRESS_STEPS


def _truth(name: str, ticks: int, meshes: str | None) -> _Truth:
    if name == "nothing":
        return _Truth(np.zeros((ticks, SIDE, SIDE), np.float32), [])
    if name == MEETING:
        objects = [_pressed(ball, side, ticks, meshes) for ball, side in (("golf-ball", -1), ("racquetball", 1))]
        force_n = np.maximum(*objects)
        return _Truth(force_n, [np.where(each == force_n, each, 0) for each in objects])
    force_n = trajectory(name, meshes=meshes, steps=ticks)
    return _Truth(force_n, [force_n])


def _pressed(ball: str, side: int, ticks: int, meshes: str | None) -> Force:
    """Return the force of one of the balls that meet, shape (ticks, SIDE, SIDE)."""
    spheres, grid = spheres_of(ball, meshes), Grid()
    return np.stack([press(grid, [(spheres, pose)]) for pose in _meeting(side, ticks)])


def _meeting(side: int, ticks: int) -> Iterator[Pose]:
    """Press a ball in far out, slide it towards the middle, and back."""
    for tick in range(ticks):
        slid = min(max((tick - MEETING_PRESS_TICKS) / (ticks - MEETING_PRESS_TICKS), 0), 1)
        far = MEETING_NEAR_M + (MEETING_FAR_M - MEETING_NEAR_M) * abs(1 - 2 * slid)
        yield Pose(0.0, side * far, 0.0, PAPER_DEPTH_M * min(1.0, tick / MEETING_PRESS_TICKS))
