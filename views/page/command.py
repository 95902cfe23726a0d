"""``skin view``: the web page of a skin, or of a recording."""

import socket
import subprocess
import sys
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Final

import uvicorn
from cyclopts import Parameter
from starlette.applications import Starlette

from canskin.errors import InputError, RunError
from canskin.messages import IMAGE
from recording import RECORDING_SUFFIX, file_of, is_recording
from recording.mcap_file import part_of, read_topics
from shell.command import WRONG_INPUT
from shell.pulse import Pulse
from shell.service import StopSignal, listen, say
from shell.skin_options import SkinOptions
from skin.layout import require_boards
from views.page.actions import live_actions, playback_actions
from views.page.app import build_app
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
    """Show a skin in a browser: images, forces, label, buses and nodes; or a recording, held, moved and hurried.

    Parameters
    ----------
    recording
        A recording (.mcap): its images as they were recorded. Where it has none, ``skin replay`` makes them first.
        Nothing is sent to a hub.
    of
        Which skin.
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
            _serve(build_app(playback, access, playback_actions(playback)), access, listener, pulse)
            return
        skin = of.find("viewer", stop)
        require_boards(skin)
        fabric = pulse.fabric = closes.enter_context(closing(of.join(skin, "viewer", pulse)))
        if stop.is_set():
            return
        recorder = closes.enter_context(closing(RecorderProcess(recordings, of.endpoint, skin.name)))
        live = Live(skin, fabric, recorder)
        actions = live_actions(live, fabric, recorder) if control or not access.is_shared else {}
        _serve(build_app(live, access, actions), access, listener, pulse)


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
    """Logs the address of the page, with its token, when the page can be opened; `pulse` beats and says when to end."""

    token = ""
    pulse: Pulse

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start serving, then log the address."""
        await super().startup(sockets)
        for listener in sockets or []:
            host, port = listener.getsockname()[:2]
            say("viewer", f"web page at http://{f'[{host}]' if ':' in host else host}:{port}/?token={self.token}")

    async def on_tick(self, counter: int) -> bool:
        """Beat, and tell whether to end; uvicorn calls it ten times a second, and in a main thread has the signals."""
        return self.pulse.is_set() or await super().on_tick(counter)


def server_config(app: Starlette) -> uvicorn.Config:
    """Return how the page is served."""
    return uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        lifespan="on",
        server_header=False,
        ws_max_size=MESSAGE_LIMIT_BYTES,
        # Frames are floats that change each time: compression costs more time than it saves on loopback.
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=FAREWELL_S,
        http=Connection,
        h11_max_incomplete_event_size=HEADERS_BYTES_MAX,
        backlog=BACKLOG,
    )


def _serve(app: Starlette, access: Access, listener: socket.socket, pulse: Pulse) -> None:
    """Serve until SIGINT or SIGTERM."""
    server = _Server(server_config(app))
    server.token, server.pulse = access.token, pulse
    server.run(sockets=[listener])
