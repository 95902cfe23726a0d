"""``skin view``: the web page of a skin."""

import socket
from collections.abc import Collection
from contextlib import closing
from ipaddress import ip_address
from typing import Final

import uvicorn

from shell.service import StopSignal, listen, say
from shell.skin_options import SkinOptions
from skin.layout import require_boards
from views.page.app import build_app
from views.page.feed import Feed
from views.page.guard import LOOPBACK

#: When the server ends, pages get this long to close their connections.
FAREWELL_S: Final = 1
#: Pages send acknowledgements only.
MESSAGE_LIMIT_BYTES: Final = 1024


def view(
    *,
    of: SkinOptions | None = None,
    host: str = "127.0.0.1",
    port: int = 8765,
) -> None:
    """Show the skin in a browser: images, label, buses and nodes.

    Parameters
    ----------
    of
        Which skin.
    host
        Address to listen on. With an address other than loopback, everybody on the network can see the skin.
    port
        Port to listen on; 0 takes a free port and prints it.

    Examples
    --------
    skin view
    skin view --connect tcp/10.0.0.5:7447 --port 0
    """
    stop, of = StopSignal().install(), of or SkinOptions()
    with listen(host, port) as listener:
        skin = of.find(stop)
        require_boards(skin)
        with closing(of.join(skin, "viewer", stop)) as fabric:
            if not stop.is_set():
                feed = Feed(skin)
                feed.join(fabric)
                _serve(feed, listener, host)


class _Server(uvicorn.Server):
    """Logs the address of the page when the page can be opened."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start serving, then log the address."""
        await super().startup(sockets)
        for listener in sockets or []:
            host, port = listener.getsockname()[:2]
            say("viewer", f"web page at http://{f'[{host}]' if ':' in host else host}:{port}/")


def _serve(feed: Feed, listener: socket.socket, host: str) -> None:
    """Serve until SIGINT or SIGTERM."""
    config = uvicorn.Config(
        build_app(feed, _hosts(host)),
        log_config=None,
        access_log=False,
        lifespan="on",
        server_header=False,
        ws_max_size=MESSAGE_LIMIT_BYTES,
        # Frames are floats that change each time: compression costs more time than it saves on loopback.
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=FAREWELL_S,
    )
    _Server(config).run(sockets=[listener])


def _hosts(host: str) -> Collection[str] | None:
    """Return the host names that a server bound to `host` answers to; None for a host bound to all addresses."""
    try:
        address = ip_address(host)
    except ValueError:
        return (*LOOPBACK, host)
    return None if address.is_unspecified else (*LOOPBACK, host)
