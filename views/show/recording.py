"""A recording drawn on a canvas."""

from contextlib import ExitStack, closing
from pathlib import Path

from canskin.errors import RunError
from recording.mcap_file import Warn, read_messages
from skin.layout import Layout
from skin.wall_times import CLOCKS, recorded_wall_times
from views.show.foxglove_canvas import FoxgloveCanvas
from views.show.painter import TOPICS, Canvas, Painter
from views.show.rerun_canvas import RerunCanvas


def write_view(source: Path, path: Path, layout: Layout, for_rerun: bool, warn: Warn) -> int:
    """Write a recording as a new file for Rerun or Foxglove; return the number of images.

    Raises
    ------
    RunError
        If the recording holds no images. After any error nothing is left of the file.
    """
    canvas: Canvas = RerunCanvas(layout, path) if for_rerun else FoxgloveCanvas(layout, path)
    with ExitStack() as undo:
        undo.callback(path.unlink, missing_ok=True)
        with closing(canvas):
            painter = Painter(layout, canvas, recorded_wall_times(source))
            for _, time_ns, message in read_messages(source, [each for each in TOPICS if each is not CLOCKS], warn):
                now_s = time_ns * 1e-9
                painter.look(now_s, time_ns)  # before the message: it may end a gap
                painter.take(message, now_s, time_ns)
        if not painter.drawn:
            raise RunError(f"{source}: holds no images: play it with 'skin replay --out'")
        undo.pop_all()
    return painter.drawn
