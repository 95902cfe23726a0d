"""``skin view``: the web page of a skin, or of a recording."""

import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Final

import uvicorn
from cyclopts import Parameter
from starlette.applications import Starlette

from canskin.errors import BusError, InputError, LayoutError, RunError, Stopped
from canskin.messages import IMAGE
from canskin.session import Stop
from health.skins import Skins
from recording import RECORDING_SUFFIX, file_of, is_recording
from recording.mcap_file import part_of, read_topics
from shell.command import WRONG_INPUT
from shell.pulse import Pulse
from shell.service import StopSignal, listen, say
from shell.skin_options import SkinOptions
from skin.layout import Layout, require_boards
from views.page.actions import live_actions, playback_actions
from views.page.app import Page, build_app
from views.page.connections import BACKLOG, HEADERS_BYTES_MAX, Connection
from views.page.guard import Access
from views.page.playback import Playback
from views.page.record_process import RecorderProcess
from views.page.shown import Live

#: When the server ends, pages get this long to close their connections.
FAREWELL_S: Final = 1
#: Pages send acknowledgements only over the WebSocket.
MESSAGE_LIMIT_BYTES: Final = 1024


def view(
    recording: Path | None = None,
    *,
    of: SkinOptions | None = None,
    host: str = "127.0.0.1",
    port: int = 8765,
    control: Annotated[bool, Parameter(negative=())] = False,
    recordings: Path = Path(),
) -> None:
    """Show skins in a browser: images, forces, label, buses and nodes; or a recording, held, moved and hurried.

    Of a hub with several skins the first page has all of them side by side, and leads to the page of each.

    Parameters
    ----------
    recording
        A recording (.mcap): its images as they were recorded. Where it has none, ``skin replay`` makes them first.
        Nothing is sent to a hub.
    of
        Which skin; default: all on the hub, those that come later, too.
    host
        Address to listen on. On another than loopback, looking needs the token of the logged address, too.
    port
        Port to listen on; 0 takes a free port and prints it.
    control
        The page can tare, record and mark also if it listens on another address than loopback.
    recordings
        Folder of the recordings that the page makes.

    Examples
    --------
    skin view
    skin view --connect tcp/10.0.0.5:7447 --port 0
    skin view run.mcap
    """
    stop, of, access = StopSignal().install(), of or SkinOptions(), Access.to(host)
    pulse = Pulse(stop)
    if not recordings.is_dir():
        raise InputError(f"--recordings {recordings}: expected a folder that exists")
    if recording is not None and of.connect:
        raise InputError("a recording has no hub: leave --connect out")
    if recording is not None and not file_of(recording).is_file():
        raise InputError(f"no file '{recording}': expected a recording of 'skin record'")
    with listen(host, port) as listener, ExitStack() as closes:
        if recording is not None:
            playback = _open(recording, of, Path(closes.enter_context(TemporaryDirectory(prefix="skin-view-"))))
            pages = {playback.layout.name: Page(playback, playback_actions(playback))}
            _serve(build_app(lambda: pages, access), access, listener, pulse.is_set)
            return
        has_actions = control or not access.is_shared
        join = partial(_LivePage, of=of, recordings=recordings, has_actions=has_actions)
        skins = closes.enter_context(closing(Skins(of.endpoint, "viewer", join)))
        for skin in (found := of.find_all("viewer", stop)):
            try:
                skins.add(skin, skin.operator().fingerprint, pulse)
            except LayoutError:
                if len(found) == 1:
                    raise  # of several skins the search says why one is not shown
        if stop.is_set():
            return
        if of.layout is None and of.skin is None:
            closes.enter_context(_searching(skins, stop))
        _serve(
            build_app(lambda: {**skins.joined}, access), access, listener, lambda: pulse.is_set() | _beat(skins.joined)
        )


class _LivePage(Page):
    """The page of a running skin."""

    def __init__(self, skin: Layout, stop: Stop, of: SkinOptions, recordings: Path, *, has_actions: bool) -> None:
        require_boards(skin)
        self.pulse = Pulse(stop)
        fabric = self._fabric = self.pulse.fabric = of.join(skin, "viewer", stop)
        self._recorder = RecorderProcess(recordings, of.endpoint, skin.name)
        live = Live(skin, fabric, self._recorder)
        super().__init__(live, live_actions(live, fabric, self._recorder) if has_actions else {})

    def close(self) -> None:
        """End the recording, leave the skin, and let pages connect anew."""
        self.stream.close()
        self._recorder.close()
        self._fabric.close()


def _beat(pages: Mapping[str, _LivePage]) -> bool:
    """Tell each skin that the page lives; return whether to end."""
    return max([each.pulse.is_set() for each in list(pages.values())], default=False)


@contextmanager
def _searching(skins: Skins[_LivePage], stop: StopSignal) -> Iterator[None]:
    """Join the skins that come, in a thread."""

    def search() -> None:
        with suppress(Stopped, BusError):
            skins.run(stop)

    thread = threading.Thread(target=search, name="search for skins")
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _open(recording: Path, of: SkinOptions, folder: Path) -> Playback:
    """Return the playback of a recording; of one without images, that of its replay, which is made in `folder`."""
    recording = part_of(recording, of.skin)
    layout = of.find(recording=recording, needs_hub=False)
    if not is_recording(recording) or IMAGE.name not in read_topics(recording):
        made, given = folder / f"{recording.stem}{RECORDING_SUFFIX}", ["--layout", str(of.layout)] if of.layout else []
        say("viewer", f"{recording} has no images: 'skin replay' makes them")
        command = [sys.executable, "-m", "skin", "replay", str(recording), "--out", str(made), *given]
        if status := subprocess.run(command, check=False).returncode:  # noqa: S603 - our own command, no shell
            kind = InputError if status == WRONG_INPUT else RunError
            raise kind(f"{recording}: no images can be made of it")
        recording = made
    return Playback(recording, layout)


class _Server(uvicorn.Server):
    """Logs the address of the page, with its token, when it can be opened; `is_over` beats and says when to end."""

    token = ""
    is_over: Callable[[], bool]

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start serving, then log the address."""
        await super().startup(sockets)
        for listener in sockets or []:
            host, port = listener.getsockname()[:2]
            say("viewer", f"web page at http://{f'[{host}]' if ':' in host else host}:{port}/?token={self.token}")

    async def on_tick(self, counter: int) -> bool:
        """Beat, and tell whether to end; uvicorn calls it ten times a second, and in a main thread has the signals."""
        return self.is_over() or await super().on_tick(counter)


def server_config(app: Starlette) -> uvicorn.Config:
    """Return how the page is served."""
    return uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        lifespan="off",
        server_header=False,
        ws_max_size=MESSAGE_LIMIT_BYTES,
        # Frames are floats that change each time: compression costs more time than it saves on loopback.
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=FAREWELL_S,
        http=Connection,
        h11_max_incomplete_event_size=HEADERS_BYTES_MAX,
        backlog=BACKLOG,
    )


def _serve(app: Starlette, access: Access, listener: socket.socket, is_over: Callable[[], bool]) -> None:
    """Serve until SIGINT or SIGTERM."""
    server = _Server(server_config(app))
    server.token, server.is_over = access.token, is_over
    server.run(sockets=[listener])
