"""``skin show``: a running skin in Rerun or Foxglove."""

import time
from collections.abc import Callable
from contextlib import closing
from typing import Annotated

import msgspec
from cyclopts import Parameter

from canskin.errors import InputError
from canskin.fabric import Fabric
from health.feed import Feed
from shell.pulse import Beat, Pulse, unheard
from shell.service import LOOK_S, StopSignal, say
from shell.skin_options import Insecure, SkinOptions
from skin.layout import Layout, require_boards
from views.show.foxglove_canvas import FoxgloveCanvas
from views.show.painter import SERVICE, TOPICS, Canvas, Painter
from views.show.rerun_canvas import RerunCanvas
from views.show.target import foxglove_target, rerun_target


def show(
    target: str = "",
    *,
    rerun: Annotated[bool, Parameter(negative=())] = False,
    foxglove: Annotated[bool, Parameter(negative=())] = False,
    insecure: Insecure = False,
    of: SkinOptions | None = None,
) -> None:
    """Show a running skin in Rerun or Foxglove: image, taxels in their places, contacts, curves, log.

    For a recording see ``skin export --to rerun`` and ``--to foxglove``.

    Parameters
    ----------
    target
        Rerun: URL or HOST:PORT of a running viewer, or a new file (.rrd); without it a viewer is started. Foxglove:
        HOST:PORT of the server that the app connects to, default 127.0.0.1:8766, or a new file (.mcap). A PORT alone is
        of 127.0.0.1.
    rerun
        Show the skin in Rerun; needs the extra canskin[rerun].
    foxglove
        Show the skin in Foxglove; needs the extra canskin[foxglove].
    insecure
        Serve Foxglove on a network: everybody there can see the skin.
    of
        Which skin.

    Examples
    --------
    skin show --rerun
    skin show --rerun rerun+http://robot:9876/proxy
    skin show --foxglove
    skin show --foxglove run-foxglove.mcap
    """
    if rerun == foxglove:
        raise InputError(f"skin show: expected --rerun or --foxglove, got {'both' if rerun else 'neither'}")
    open_canvas = _opener(target, for_rerun=rerun, insecure=insecure)
    stop, of = StopSignal().install(), of or SkinOptions()
    pulse = Pulse(stop)
    skin = of.find(SERVICE, stop)
    require_boards(skin)
    with (
        closing(of.join(skin, SERVICE, pulse)) as fabric,
        closing(open_canvas(skin)) as canvas,
    ):
        pulse.fabric = fabric
        draw_live(skin, fabric, canvas, stop, pulse.beat)


def draw_live(layout: Layout, fabric: Fabric, canvas: Canvas, stop: StopSignal, beat: Beat = unheard) -> Painter:
    """Draw the newest messages of a running skin until `stop`."""
    painter = Painter(layout, canvas)

    def take(message: msgspec.Struct, at_s: float) -> None:
        painter.take(message, at_s, time.time_ns())

    feed = Feed(fabric, TOPICS, take, painter.take_peer, newest=True)
    while not stop.is_set():
        painter.look(feed.read(LOOK_S), time.time_ns(), feed.malformed)
        beat(0)
    return painter


def _opener(target: str, *, for_rerun: bool, insecure: bool) -> Callable[[Layout], Canvas]:
    """Check the target, before anything else is opened; return what opens the canvas."""
    if for_rerun:
        viewer = rerun_target(target)
        return lambda skin: RerunCanvas(skin, viewer)
    app = foxglove_target(target, insecure=insecure)
    return lambda skin: _serving(FoxgloveCanvas(skin, app))


def _serving(canvas: FoxgloveCanvas) -> FoxgloveCanvas:
    if canvas.address:
        say(SERVICE, f"open {canvas.address} in Foxglove: 'Open connection', 'Foxglove WebSocket'")
    return canvas
