"""``skin evaluate postures``: how a person lies, from sums of a real pressure mat, for people never met before.

Guessing gives 5.9 %. Figures are means over persons; ``least`` and ``most`` are the worst and the best person. Roots of
the pressures differ less between heavy and light persons than the pressures.
"""

import re
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from classifier.dagsvm import DagSvm
from classifier.rows import choose_rows
from classifier.training import C_GRID
from classifier.validation import choose_C, global_scale, part_of
from evaluation.observations import TAXELS, all_rows, drawn_sbhe, measured
from evaluation.recognition.accuracy import MOST_ITERATIONS
from evaluation.recognition.pictures import draw_gains, gain_row
from evaluation.result import Options, Picture, Result, Row, grouped
from evaluation.result_cache import measured_rows
from touch.reading import read_counts

SIZES: Final = (4096, 256, 64, 16)
DRAWS: Final = 10
#: Most rows that are chosen: the time to choose them grows with the square.
_MOST_CHOSEN: Final = 64
#: One frame in `STRIDE` is used: neighbours hardly differ.
STRIDE: Final = 4
#: The first and last frames of a posture may show the person moving.
_EDGE: Final = 5
#: One hot taxel must not decide the scale.
_FULL_SCALE_QUANTILE: Final = 0.995
_SIDE: Final = 64
POSTURES: Final = tuple(f"posture_{number:02d}" for number in range(1, 18))
#: Name: (taxels give the root of the pressure, every frame is brought to unit length, rows are chosen).
VARIANTS: Final = {
    "raw sums, one scale": (False, False, False),
    "raw sums, unit length": (False, True, False),
    "sums of roots, unit length": (True, True, False),
    "sums of roots, unit length, rows chosen": (True, True, True),
}


class Postures(NamedTuple):
    """Frames, float32, shape (frames, 4096), 0 to 1; the posture and the person of each."""

    frames: npt.NDArray[np.float32]
    postures: npt.NDArray[np.intp]
    people: npt.NDArray[np.intp]


def evaluate(options: Options) -> Result:
    """Recognise the posture of each person by machines trained on all the others."""
    title = "A second task: postures on a real pressure mat"
    if options.recordings is None:
        return Result(title, [], note="Needs the recordings of a pressure mat: give their folder with --recordings.")
    draws = options.draws_or(DRAWS)
    people = range(len(people_files(options.recordings)))
    cells: list[Row] = [
        {"recordings": str(options.recordings), "variant": name, "size": size, "draw": draw, "person": person}
        for size in (SIZES[-1:] if options.quick else SIZES)
        for name in VARIANTS
        if size <= _MOST_CHOSEN or not VARIANTS[name][2]
        for draw in range(1 if size == TAXELS else draws)
        for person in people
    ]
    groups = grouped(measured_rows(measure_postures, cells, options, "postures"), "variant", "size")
    plain = {size: _mean(found) for (name, size), found in groups.items() if name == next(iter(VARIANTS))}
    rows = []
    for (name, size), found in groups.items():
        each = [_mean(own) for own in grouped(found, "person").values()]
        rows.append(gain_row(name, size, runs=len(found), ours=_mean(found), plain=plain[size], parts=each))
    return Result(title, rows, [Picture(_CAPTION, lambda: draw_gains(rows))])


def measure_postures(*, recordings: str, variant: str, size: int, draw: int, person: int) -> Row:
    """Return the accuracy on one person's frames, of machines that never met the person.

    C is chosen on the person after, by machines trained on the others; then all but the person train.
    """
    rooted, unit, chosen_rows = VARIANTS[variant]
    frames, postures, people = read_postures(recordings)
    others = [other for other in np.unique(people) if other != person]
    test, validation = np.flatnonzero(people == person), np.flatnonzero(people == others[person % len(others)])
    development = np.setdiff1d(np.flatnonzero(people != person), validation)
    training = np.concatenate([development, validation])
    felt = np.sqrt(frames) if rooted else frames
    phi = drawn_sbhe(size, draw)
    if chosen_rows:
        every = all_rows(draw)
        phi = choose_rows(every, measured(every, felt[training]), postures[training], size)
    sums = felt if size == TAXELS else measured(phi, felt)
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    X = sums / np.maximum(lengths, 1e-9) if unit else sums * np.float32(global_scale(sums[development]))
    machine = DagSvm(max_iter=MOST_ITERATIONS)
    if size >= len(frames):
        X, machine = X @ X.T, DagSvm(kernel="precomputed", max_iter=MOST_ITERATIONS)
    chosen = choose_C(X, postures, development, validation, machine=machine, C_grid=C_GRID)
    said = chosen.machine.predict(part_of(X, test, training, chosen.machine))
    return {"accuracy": float(np.mean(said == postures[test]))}


def people_files(folder: Path) -> list[Path]:
    """Return the recordings of a folder, 3 or more: ``S1.npz``, ``S2.npz``, …, a person each."""
    found = sorted(path for path in folder.glob("S*.npz") if re.fullmatch(r"S\d+", path.stem))
    if len(found) < 3:
        raise InputError(f"'{folder}': expected recordings of 3 or more people, S1.npz, S2.npz, …: got {len(found)}")
    return found


@cache
def read_postures(folder: str) -> Postures:
    """Return some frames of every person and posture, in the middle of 64 x 64 taxels."""
    images, postures, people = [], [], []
    for person, path in enumerate(people_files(Path(folder))):
        for posture, counts in enumerate(read_counts(path, POSTURES, (_SIDE, _SIDE))):
            images.append(_centred(counts[_EDGE:-_EDGE:STRIDE], path))
            postures += [posture] * len(images[-1])
            people += [person] * len(images[-1])
    frames = np.concatenate(images)
    full_scale = float(np.quantile(frames[frames > 0], _FULL_SCALE_QUANTILE))
    return Postures(np.minimum(frames / full_scale, 1).astype(np.float32), np.array(postures), np.array(people))


def _centred(counts: npt.NDArray[Any], path: Path) -> npt.NDArray[np.float32]:
    rows, columns = counts.shape[1:]
    if rows > _SIDE or columns > _SIDE or not len(counts):
        raise InputError(
            f"'{path}': expected postures of more than {2 * _EDGE} frames of up to {_SIDE} x {_SIDE} taxels"
        )
    top, left = (_SIDE - rows) // 2, (_SIDE - columns) // 2
    placed = np.zeros((len(counts), _SIDE, _SIDE), np.float32)
    placed[:, top : top + rows, left : left + columns] = counts
    return placed.reshape(len(counts), -1)


def _mean(found: list[Row]) -> float:
    return float(100 * np.mean([row["accuracy"] for row in found]))


_CAPTION: Final = (
    "Postures of a person never met, from sums of a real pressure mat. Whiskers span the people; the dotted line is "
    "the paper's way with raw sums."
)
