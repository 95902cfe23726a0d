"""``skin evaluate recordings DIR``: all schemes on the user's own recordings, and on whose side each of them is."""

import math
from pathlib import Path
from typing import Final

import numpy as np

from canskin.errors import InputError
from evaluation.result import Options, Result
from evaluation.schemes.comparison import compared, means_of, measured
from evaluation.schemes.scenes import RECORDED_MS, Touch, recordings_in
from shell.service import say
from skin.ranges import require_above_zero
from skin.taxel import FORCE_MAX_N

#: Most recordings that are shown, and milliseconds of each, in a quick look.
MOST: Final = 8
QUICK_MOST: Final = 2
QUICK_TICKS: Final = 600
TITLE: Final = "Schemes on recordings"


def evaluate(options: Options) -> Result:
    """Measure every scheme on recordings of a folder, and tell wins and losses.

    Parameters
    ----------
    options : Options
        `recordings` is the folder; `full_scale` and `frame_rate_hz` are those of the recordings; `seed` draws up to
        `MOST` of them, and the frames of each.
    """
    if options.recordings is None:
        return Result(TITLE, [], note="Needs recordings of a pressure mat, glove or skin: give their folder.")
    touches = _shown(options, options.recordings)
    found = measured(touches, options, TITLE)
    together = means_of(found, {touch.words for touch in touches}, "all recordings") if len(touches) > 1 else []
    return compared(TITLE, together + found, _units(options, touches[0]))


def _shown(options: Options, folder: Path) -> list[Touch]:
    """Return the recordings that are shown; say which files cannot be."""
    if options.full_scale is not None:
        require_above_zero("the full scale (--full-scale)", options.full_scale)
    paths = recordings_in(folder)
    most = QUICK_MOST if options.quick else MOST
    touches: list[Touch] = []
    first: InputError | None = None
    for path in np.random.default_rng(options.seed).permutation(paths).tolist():
        touch = Touch(
            path,
            ticks=QUICK_TICKS if options.quick else None,
            seed=options.seed,
            full_scale=options.full_scale,
            frame_ms=_frame_ms(options),
        )
        try:
            touch.load()
        except InputError as error:
            first = first or error
            say("recordings", f"left out: {error}")
        else:
            touches.append(touch)
        if len(touches) == most:
            break
    if first is not None and not touches:
        raise InputError(f"no recording in '{folder}' can be shown: {first}")
    return sorted(touches, key=lambda touch: touch.name)


def _frame_ms(options: Options) -> int:
    if options.frame_rate_hz is None:
        return RECORDED_MS
    if not math.isfinite(options.frame_rate_hz) or not 1 <= options.frame_rate_hz <= 1000:
        raise InputError(f"expected 1 to 1000 frames per second (--rate), got {options.frame_rate_hz:g}")
    return round(1000 / options.frame_rate_hz)


def _units(options: Options, touch: Touch) -> str:
    """Return what a millinewton, and a second, is of the recordings."""
    value = "the largest value of each recording" if options.full_scale is None else f"{options.full_scale:g}"
    given = "given" if options.frame_rate_hz is not None else "assumed, see --rate"
    return (
        f"Forces: {1e3 * FORCE_MAX_N:g} mN are {value} (--full-scale), in an .mcap newtons are newtons; a recorded"
        f" frame lasts {touch.frame_ms} ms ({given}). What was recorded, noise included, counts as the truth; the"
        f" images of an .mcap were made by our solver, which favours ours.\n"
    )
