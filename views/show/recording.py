"""A recording drawn on a canvas."""

from collections.abc import Callable
from pathlib import Path

from canskin.errors import RunError
from skin.layout import Layout
from skin.mcap_file import read_messages, wall_offset_ns
from skin.wall_times import WallTimes
from views.show.foxglove_canvas import FoxgloveCanvas
from views.show.painter import TOPICS, Canvas, Painter
from views.show.rerun_canvas import RerunCanvas


def write_view(source: Path, path: Path, layout: Layout, for_rerun: bool, warn: Callable[[str], None]) -> int:
    """Write a recording as a file for Rerun or Foxglove; return the number of images.

    Parameters
    ----------
    source : pathlib.Path
        A recording.
    path : pathlib.Path
        A new file; nothing is left of it after an error.
    layout : Layout
        Of the recording.
    warn : callable
        Receives one line of text if the recording is cut.

    Raises
    ------
    RunError
        If the recording holds no images.
    """
    canvas: Canvas = RerunCanvas(layout, path) if for_rerun else FoxgloveCanvas(layout, path)
    try:
        return draw_recording(source, layout, canvas, warn)
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def draw_recording(source: Path, layout: Layout, canvas: Canvas, warn: Callable[[str], None]) -> int:
    """Draw the messages of a recording; return the number of images.

    Parameters
    ----------
    source : pathlib.Path
        A recording.
    layout : Layout
        Of the recording.
    canvas : Canvas
        Is closed at the end.
    warn : callable
        Receives one line of text if the recording is cut.

    Raises
    ------
    RunError
        If the recording holds no images.
    """
    offset_ns = wall_offset_ns(source)
    painter = Painter(layout, canvas, WallTimes(offset_ns))
    try:
        for _, time_ns, message in read_messages(source, TOPICS, warn):
            now_s = time_ns * 1e-9
            painter.look(now_s, time_ns)  # before the message: it may end a gap
            painter.take(message, now_s, time_ns)
    finally:
        canvas.close()
    if not painter.drawn:
        raise RunError(f"{source}: holds no images: play it with 'skin replay --out'")
    return painter.drawn
