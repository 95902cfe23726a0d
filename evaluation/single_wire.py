"""``skin evaluate single-wire``: sums that other hardware made, solved by our solver and by its authors' method.

The data is that of github.com/aslepyan/SPTS: 10 x 10 taxels on one wire, each with a code of 0 or 1 for every sum, 100
sums a frame. Frame f of a press, both from 1, has the codes of frame ``framePosition`` + f - `FRAMES_BEFORE`. The
hardware subtracts a taxel whose code is 0, so a sum is Φx with Φ = 2 · codes - 1, above a zero of its own.
"""

import warnings
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from statistics import mean
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from evaluation.result import Options, Result, Row, grouped
from evaluation.result_cache import measure_cells
from reconstructor.checks import Values
from reconstructor.engine import Reconstructor
from skin.matrix import MatrixPhi
from skin.taxel import FORCE_MAX_N

#: Taxels of a side, and of all; sums of a frame.
SIDE: Final = 10
TAXELS: Final = SIDE * SIDE
SUMS: Final = 100
#: The generator of the codes, s' = MULTIPLIER s + INCREMENT modulo 2³², and the seed of the first taxel.
MULTIPLIER: Final = 1664525
INCREMENT: Final = 1013904223
FIRST_SEED: Final = 8
FRAMES_BEFORE: Final = 1000
#: The authors' choice: presses 6 to 15, frames 501 to 700 of a press; press 10, frame 600 of the scan is the truth.
PRESSES: Final = tuple(range(5, 15))
JUDGED: Final = range(500, 700)
TRUTH_FRAME, TRUTH_PRESS = 599, 9
#: Every tenth frame is judged, where the authors judge all.
STEP: Final = 10
#: A taxel is touched where it is above this part of the largest.
SUPPORT_RATIO: Final = 0.23
#: Atoms of matching pursuit.
ATOMS: Final = 20
#: Sums of a frame that the methods get, of the first 50; the last 50 judge the image.
SIZES: Final = (7, 15, 30, 50)
UNSEEN: Final = slice(50, SUMS)
#: Frames before the touch, whose mean is the zero.
IDLE: Final = slice(0, 100)
#: Names of methods.
OURS: Final = "ours"
PLAIN: Final = "pursuit, codes 0/1"
SOURCE: Final = "github.com/aslepyan/SPTS"
_MEASURED: Final = "Measurements_Collected"
_DICTIONARY: Final = "Dictionary_Learning/dictionary.mat"


class Press(NamedTuple):
    """One press of an object.

    Attributes
    ----------
    codes : array of int8, shape (frames, SUMS, TAXELS)
        0 and 1.
    sums : array, shape (frames, SUMS)
        Volts; NaN for a sum that did not come.
    """

    codes: npt.NDArray[np.int8]
    sums: Values


def evaluate(options: Options) -> Result:
    """Solve every press with each method, from the same sums, and judge the images by the authors' rule.

    Parameters
    ----------
    options : Options
        `recordings` is the folder of the data; `quick` looks at one press of each object.
    """
    if options.recordings is None:
        raise InputError(f"expected a copy of {SOURCE}: give its folder")
    folder = _data_in(options.recordings)
    names, left_out = objects_in(folder)
    cells: list[Row] = [
        {"folder": str(folder), "name": name, "press": press, "step": STEP * (2 if options.quick else 1)}
        for name in names
        for press in (PRESSES[:1] if options.quick else _presses(folder, name))
    ]
    found = [row for rows in measure_cells(measure_press, cells, options, "presses") for row in rows["rows"]]
    rows = []
    for (method, size), mine in grouped(found, "method", "sums").items():
        of_objects = [mean(row["support"] for row in each) for each in grouped(mine, "object").values()]
        rows.append(
            {
                "method": method,
                "sums": size,
                "support": round(mean(of_objects), 3),
                "support_least": round(min(of_objects), 3),
                "unseen_error": round(mean(row["unseen_error"] for row in mine), 3),
                "images": sum(row["images"] for row in mine),
            }
        )
    note = f"Objects: {', '.join(names)}." + f" Left out, without sums that can be read: {left_out}." * bool(left_out)
    title = "Sums of a single-wire skin: our solver beside its authors' method"
    return Result(title, rows, note=note)


def measure_press(*, folder: str, name: str, press: int, step: int) -> Row:
    """Return the ``rows`` of one press: each method with each number of sums, means over the judged frames."""
    seen = read_press(Path(folder), name, press)
    touched = support(_truth(Path(folder), name))
    zero = float(np.nanmean(seen.sums[IDLE]))
    dictionary = _array(Path(folder) / _DICTIONARY, "Dksvd", (TAXELS, None))
    judged = range(JUDGED.start, JUDGED.stop, step)
    rows: list[Row] = []
    for size in SIZES:
        for method, images in {
            OURS: ours(seen, size, zero),
            "ours, one frame": ours(seen, size, zero, judged),
            PLAIN: pursuits(seen, size, zero, dictionary, judged, is_signed=False),
            "pursuit, codes ±1": pursuits(seen, size, zero, dictionary, judged),
            f"pursuit, codes ±1, the last {SUMS} sums": pursuits(
                seen, size, zero, dictionary, judged, frames=-(-SUMS // size)
            ),
        }.items():
            kept = {frame: image for frame, image in images if frame in judged}
            errors = [_unseen_error(seen, frame, zero, image, method != PLAIN) for frame, image in kept.items()]
            rows.append(
                {
                    "object": name,
                    "method": method,
                    "sums": size,
                    "support": mean(float(np.mean(support(image) == touched)) for image in kept.values()),
                    "unseen_error": mean(errors),
                    "images": len(kept),
                }
            )
    return {"rows": rows}


def ours(seen: Press, size: int, zero: float, alone: range | None = None) -> Iterator[tuple[int, Values]]:
    """Yield each frame up to the last that is judged and its image in volts, by the solver of the service.

    Full scale, `FORCE_MAX_N`, is 1 V. The frames `alone` are solved without those before.
    """
    signs = 2 * seen.codes[: JUDGED.stop, :size] - 1
    phi = MatrixPhi(signs)
    engine = Reconstructor(phi, SIDE, SIDE)
    for frame in alone or range(len(signs)):
        if alone:
            engine.restart()
        volts = seen.sums[frame, :size] - zero
        came = np.isfinite(volts)
        image = engine.solve(np.where(came, volts, 0) * FORCE_MAX_N, came, phi.of_cycle(frame + 1))
        yield frame, image.ravel().astype(np.float64) / FORCE_MAX_N


def pursuits(
    seen: Press,
    size: int,
    zero: float,
    dictionary: Values,
    judged: range,
    *,
    is_signed: bool = True,
    frames: int = 1,
) -> Iterator[tuple[int, Values]]:
    """Yield each judged frame and its image by orthogonal matching pursuit in the learned dictionary, volts.

    Parameters
    ----------
    is_signed : bool
        Codes of ±1 and sums above the zero; without it codes of 0 and 1 and sums as they are, as the authors do.
    frames : int
        Newest frames whose sums are taken together.
    """
    from sklearn.linear_model import orthogonal_mp

    for frame in judged:
        newest = slice(frame + 1 - frames, frame + 1)
        codes = seen.codes[newest, :size].reshape(-1, TAXELS).astype(np.float64)
        sums = seen.sums[newest, :size].ravel()
        matrix, volts = (2 * codes - 1, sums - zero) if is_signed else (codes, sums)
        came = np.isfinite(volts)
        atoms = matrix[came] @ dictionary
        with warnings.catch_warnings():  # pursuit ends before where the sums tell no further atom apart
            warnings.simplefilter("ignore", RuntimeWarning)
            chosen = orthogonal_mp(atoms, volts[came], n_nonzero_coefs=min(ATOMS, *atoms.shape))
        yield frame, dictionary @ chosen


def support(image: Values) -> npt.NDArray[np.bool_]:
    """Tell which taxels are touched, shape (TAXELS,)."""
    touched: npt.NDArray[np.bool_] = image > SUPPORT_RATIO * image.max()
    return touched


def _unseen_error(seen: Press, frame: int, zero: float, image: Values, is_signed: bool) -> float:
    """Return ‖y - Φx‖ / ‖y‖ of the sums of a frame that no method saw, Φ and y as the method takes them."""
    codes, volts = seen.codes[frame, UNSEEN], seen.sums[frame, UNSEEN] - zero
    expected = (2.0 * codes - 1) @ image if is_signed else codes @ image - zero
    return float(np.sqrt(np.nansum((volts - expected) ** 2) / np.nansum(volts**2)))


def drawn_codes(first: int, frames: int) -> npt.NDArray[np.int8]:
    """Return the codes of frames, 0 and 1, shape (frames, SUMS, TAXELS), from frame `first`, from 0."""
    multiplier, increment = np.ones((2, SUMS), np.uint32)
    factor, added = 1, 0
    for place in range(SUMS):
        factor, added = factor * MULTIPLIER % 2**32, (added * MULTIPLIER + INCREMENT) % 2**32
        multiplier[place], increment[place] = factor, added
    state = np.arange(FIRST_SEED, FIRST_SEED + TAXELS, dtype=np.uint32)
    for _ in range(first):
        state = state * multiplier[-1] + increment[-1]
    codes = np.empty((frames, SUMS, TAXELS), np.int8)
    for each in codes:
        states = state * multiplier[:, None] + increment[:, None]
        each[:], state = states >> 31, states[-1]  # the most significant byte is at least 128
    return codes


def _data_in(folder: Path) -> Path:
    """Return the folder that holds the measurements: `folder`, or a folder in it."""
    for each in (folder, folder / "Data_Analysis"):
        if (each / _MEASURED).is_dir():
            return each
    raise InputError(f"no {_MEASURED} in '{folder}': expected a copy of {SOURCE}")


def objects_in(folder: Path) -> tuple[list[str], str]:
    """Return the objects whose sums can be read, in order; and the names of the others, with commas between."""
    names = sorted(path.name for path in (folder / _MEASURED).iterdir() if path.is_dir())
    whole = [name for name in names if _is_whole(folder, name)]
    if not whole:
        raise InputError(
            f"no sums in '{folder / _MEASURED}': expected a folder for each object NAME, with NAME_random2.mat,"
            f" NAME_random2_time.mat and NAME_raster.mat"
        )
    return whole, ", ".join(name for name in names if name not in whole)


def _is_whole(folder: Path, name: str) -> bool:
    return all(
        (path := _file(folder, name, what)).is_file() and path.stat().st_size
        for what in ("random2", "random2_time", "raster")
    )


def _file(folder: Path, name: str, what: str) -> Path:
    return folder / _MEASURED / name / f"{name}_{what}.mat"


def _presses(folder: Path, name: str) -> list[int]:
    """Return the presses of `PRESSES` that there are: one object has 14 presses."""
    count = _array(_file(folder, name, "random2"), "C", (SUMS, JUDGED.stop, PRESSES[0] + 1)).shape[2]
    return [press for press in PRESSES if press < count]


def read_press(folder: Path, name: str, press: int) -> Press:
    """Return a press, numbered from 0, up to the last frame that is judged."""
    sums = _array(_file(folder, name, "random2"), "C", (SUMS, JUDGED.stop, press + 1))
    first = _array(_file(folder, name, "random2_time"), "framePosition", (1, press + 1))
    starts = int(first.ravel()[press]) - FRAMES_BEFORE
    if starts < 0:
        raise InputError(f"'{_file(folder, name, 'random2_time')}': press {press + 1} begins before its codes")
    return Press(drawn_codes(starts, JUDGED.stop), sums[:, : JUDGED.stop, press].T)


def _truth(folder: Path, name: str) -> Values:
    scans = _array(_file(folder, name, "raster"), "D", (TAXELS, TRUTH_FRAME + 1, TRUTH_PRESS + 1))
    truth: Values = scans[:, TRUTH_FRAME, TRUTH_PRESS]
    return truth


@cache
def _array(path: Path, name: str, least: tuple[int | None, ...]) -> Values:
    """Return an array of a ``.mat``; raise InputError if it is not there, or smaller than `least` along any axis."""
    from scipy.io import loadmat

    try:
        array: Any = loadmat(path, variable_names=[name]).get(name)
    except Exception as error:  # SciPy raises many kinds of errors for damaged files
        raise InputError(f"'{path}' cannot be read as .mat: {error}") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "iuf" or array.ndim != len(least):
        raise InputError(f"'{path}': expected the array '{name}' of {len(least)} axes")
    if any(has < (needs or 1) for has, needs in zip(array.shape, least, strict=True)):
        raise InputError(f"'{path}' array '{name}': expected at least {least}, got {array.shape}")
    return array.astype(np.float64)
