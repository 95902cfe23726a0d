"""The HTTP server: the page and its files, frames by WebSocket, and the state as JSON."""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Collection
from importlib.resources import files
from typing import Final

import msgspec
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from views.colours import script
from views.page.feed import Feed
from views.page.guard import LOOPBACK, Guard
from views.page.stream import FrameStream, serve_page
from views.page.wire import frame, greeting

STATIC: Final = str(files("views.page") / "static")


def build_app(feed: Feed, hosts: Collection[str] | None = LOOPBACK) -> Starlette:
    """Return the application that shows `feed`.

    Paths: ``/`` the page; ``/static`` its files; ``/ws`` a greeting as text, then frames (`views.page.wire`), and the
    page answers each frame with a text message; ``/api/state`` the snapshot as JSON; ``/healthz``.

    Parameters
    ----------
    hosts : collection of str, or None
        See `views.page.guard.Guard`.
    """
    stream = FrameStream(lambda: frame(*feed.snapshot()))
    hello = msgspec.json.encode(greeting(feed.layout)).decode()

    async def page(_request: Request) -> Response:
        return FileResponse(f"{STATIC}/index.html", media_type="text/html")

    async def colour_script(_request: Request) -> Response:
        return Response(script(), media_type="text/javascript")

    async def state(_request: Request) -> Response:
        return Response(msgspec.json.encode(feed.snapshot()[0]), media_type="application/json")

    async def health(_request: Request) -> Response:
        return Response(b'{"status":"ok"}', media_type="application/json")

    async def live(websocket: WebSocket) -> None:
        await websocket.accept()
        await websocket.send_text(hello)
        await serve_page(websocket, stream)

    @contextlib.asynccontextmanager
    async def lifespan(_app: Starlette) -> AsyncIterator[None]:
        streaming = asyncio.create_task(stream.run())
        yield
        streaming.cancel()

    return Starlette(
        routes=[
            Route("/", page),
            Route("/api/state", state),
            Route("/healthz", health),
            WebSocketRoute("/ws", live),
            Route("/static/colours.js", colour_script),
            Mount("/static", StaticFiles(directory=STATIC)),
        ],
        middleware=[Middleware(Guard, hosts=hosts)],
        lifespan=lifespan,
    )
