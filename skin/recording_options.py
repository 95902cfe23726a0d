"""The options of verbs that play or measure a recording of forces."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from canskin.errors import InputError
from skin.layout import Layout
from skin.sources import StrokeKind, TaxelSource, load_source, step_rate_hz

FullScale = Annotated[
    float | None,
    Parameter(
        help="Recorded value that becomes the skin's largest force; default: the largest value of the recording."
    ),
]
ArrayNames = Annotated[
    list[str] | None, Parameter(help="Name of an array in the .npz; two arrays are placed side by side.")
]
FrameRate = Annotated[
    float | None,
    Parameter(
        help="Frames per second of the recording; without this option each cycle plays the next frame (adaptive"
        " layouts: each 10 ms)."
    ),
]


def check_touch_options(
    recording: Path | None,
    stroke: StrokeKind,
    full_scale: float | None,
    arrays: Sequence[str] | None,
    frame_rate_hz: float | None,
) -> None:
    """Check that no option of a recording was given for objects, and none of objects for a recording.

    Raises
    ------
    InputError
        If one was given; the message names the flag.
    """
    for flag, value in (("--array", arrays), ("--full-scale", full_scale), ("--rate", frame_rate_hz)):
        if recording is None and value not in ((), [], None):
            raise InputError(f"{flag} is for a recording: give one with --input")
    if recording is not None and stroke != "slide":
        raise InputError("--stroke is for objects: a recording shows its own touches")


def load_recording(
    layout: Layout, path: Path, full_scale: float | None, arrays: Sequence[str] | None, frame_rate_hz: float | None
) -> TaxelSource:
    """Return a recording as the taxels of a skin; errors as in `skin.sources.load_source`."""
    taxels = layout.taxels
    return load_source(
        "recording",
        path=path,
        rows=taxels.rows,
        columns=taxels.columns,
        full_scale=full_scale,
        force_max_n=taxels.force_max_n,
        arrays=tuple(arrays) if arrays else None,
        rate_hz=step_rate_hz(layout),
        frame_rate_hz=frame_rate_hz,
    )
