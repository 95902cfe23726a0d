"""``skin show``: a running skin in Rerun or Foxglove."""

import time
from functools import partial
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

from canskin.errors import InputError
from canskin.fabric import Fabric
from canskin.session import DEFAULT_ENDPOINT
from show.foxglove_canvas import FoxgloveCanvas
from show.painter import TOPICS, Canvas, Painter
from show.rerun_canvas import RerunCanvas
from skin.layout import Layout, load_layout
from skin.newest import Newest
from skin.output import check_new_path
from skin.service import LOOK_S, StopSignal, say

SERVICE: Final = "show"
#: Foxglove's own default, 8765, is that of ``skin view``.
FOXGLOVE_ADDRESS: Final = "127.0.0.1:8766"


def show(
    target: str = "",
    *,
    rerun: Annotated[bool, Parameter(negative=())] = False,
    foxglove: Annotated[bool, Parameter(negative=())] = False,
    layout: Path | None = None,
    connect: str = DEFAULT_ENDPOINT,
) -> None:
    """Show a running skin in Rerun or Foxglove: image, taxels in their places, contacts, curves, log.

    For a recording see ``skin export --to rerun`` and ``--to foxglove``.

    Parameters
    ----------
    target
        Rerun: the address of a running viewer, or a new file (.rrd); without it a viewer is started. Foxglove:
        HOST:PORT of the server that the app connects to, default 127.0.0.1:8766, or a new file (.mcap).
    rerun
        Show the skin in Rerun; needs the extra canskin[rerun].
    foxglove
        Show the skin in Foxglove; needs the extra canskin[foxglove].
    layout
        TOML of the skin; without it the default skin.
    connect
        Endpoint of the fabric's hub.

    Examples
    --------
    skin show --rerun
    skin show --rerun rerun+http://robot:9876/proxy
    skin show --foxglove
    skin show --foxglove run-foxglove.mcap
    """
    if rerun == foxglove:
        raise InputError(f"skin show: expected --rerun or --foxglove, got {'both' if rerun else 'neither'}")
    _check(target, ".rrd" if rerun else ".mcap")
    skin = load_layout(layout, adaptive=True)
    stop = StopSignal().install()
    fabric = Fabric(skin.name, SERVICE, connect, stop=stop, fingerprint=skin.phi().fingerprint)
    try:
        canvas = RerunCanvas(skin, target) if rerun else _serving(skin, target or FOXGLOVE_ADDRESS)
        try:
            draw_live(skin, fabric, canvas, stop)
        finally:
            canvas.close()
    finally:
        fabric.close()


def draw_live(layout: Layout, fabric: Fabric, canvas: Canvas, stop: StopSignal) -> Painter:
    """Draw the newest messages of a running skin until `stop`."""
    painter, newest = Painter(layout, canvas), Newest()
    for topic in TOPICS:
        fabric.subscribe(topic, partial(newest.put, topic.name))
    while not stop.is_set():
        for message in newest.take(LOOK_S):
            painter.take(message, time.monotonic(), time.time_ns())
        painter.look(time.monotonic(), time.time_ns())
    return painter


def _check(target: str, suffix: str) -> None:
    """Check a target that is a file, before anything else is opened.

    Raises
    ------
    InputError
        If no file can be written there.
    """
    is_address = not target or "://" in target or target.rpartition(":")[2].isdecimal()
    if is_address:
        return
    if Path(target).suffix.lower() != suffix:
        raise InputError(f"{target}: expected an address, or a new file that ends in {suffix}")
    check_new_path(Path(target), "view")


def _serving(skin: Layout, target: str) -> FoxgloveCanvas:
    canvas = FoxgloveCanvas(skin, target)
    if canvas.address:
        say(SERVICE, f"open {canvas.address} in Foxglove: 'Open connection', 'Foxglove WebSocket'")
    return canvas
