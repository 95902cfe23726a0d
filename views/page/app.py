"""The HTTP server: the page and its files, frames by WebSocket, state and history, and what the page asks for."""

import asyncio
import contextlib
import math
from collections.abc import AsyncIterator, Mapping
from functools import partial
from importlib.resources import files
from typing import Any, Final

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from canskin.errors import UNDECODABLE, SkinError
from views.colours import script
from views.page.actions import ACTIONS, Action
from views.page.guard import HEALTH, Access, Guard
from views.page.shown import Shown
from views.page.stream import FrameStream, serve_page
from views.page.wire import frame, greeting

STATIC: Final = str(files("views.page") / "static")


#: Longest request.
REQUEST_BYTES: Final = 4096


def build_app(shown: Shown, access: Access | None = None, actions: Mapping[str, Action] | None = None) -> Starlette:
    """Return the application that shows a skin or a recording.

    Paths: ``/`` the page; ``/static`` its files; ``/ws`` a greeting as text, then frames (`views.page.wire`), and the
    page answers each frame with a text message; ``/api/state`` the snapshot as JSON; ``/api/history?after_s=T`` the
    moments of the last minutes (`views.page.history`); ``/api/frame?time_s=T`` the frame nearest to a time of them;
    ``/healthz``. POST ``/api/NAME`` with a request as JSON does what `views.page.actions` says, and answers with
    ``text``, what was done, or ``error``.

    Parameters
    ----------
    access : Access, optional
        Whom the server serves; default: this machine, with a new token.
    actions : mapping of str to Action, optional
        What the page may ask for; without them nothing.
    """
    allowed = actions or {}
    stream = FrameStream(lambda: frame(*shown.snapshot()))
    hello = msgspec.json.encode(greeting(shown.layout, list(allowed))).decode()

    async def page(_request: Request) -> Response:
        return FileResponse(f"{STATIC}/index.html", media_type="text/html")

    async def colour_script(_request: Request) -> Response:
        return Response(script(), media_type="text/javascript")

    async def state(_request: Request) -> Response:
        return Response(msgspec.json.encode(shown.snapshot()[0]), media_type="application/json")

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
            Route("/api/history", partial(_history, shown=shown)),
            Route("/api/frame", partial(_frame, shown=shown)),
            Route("/api/{name}", partial(_act, allowed=allowed), methods=["POST"]),
            Route(HEALTH, health),
            WebSocketRoute("/ws", live),
            Route("/static/colours.js", colour_script),
            Mount("/static", StaticFiles(directory=STATIC)),
        ],
        middleware=[Middleware(Guard, access=access or Access())],
        lifespan=lifespan,
    )


async def _history(request: Request, shown: Shown) -> Response:
    return _json(200, shown.history(_time_s(request, "after_s", -math.inf)))


async def _frame(request: Request, shown: Shown) -> Response:
    content = shown.frame(_time_s(request, "time_s", math.inf))
    if content is None:
        return _json(404, {"error": "nothing is kept of that time"})
    return Response(content, media_type="application/octet-stream")


async def _act(request: Request, allowed: Mapping[str, Action]) -> Response:
    """Do what the page asks for; answer when it is done or refused."""
    name = request.path_params["name"]
    if name not in ACTIONS:
        return _json(404, {"error": f"expected one of {', '.join(ACTIONS)}, got '{name[:64]}'"})
    if name not in allowed:
        why = (
            f"this server allows {', '.join(allowed)}"
            if allowed
            else "this server only shows: start 'skin view --control'"
        )
        return _json(403, {"error": f"no {name} here: {why}"})
    length = request.headers.get("content-length", "")
    if not length.isdecimal() or int(length) > REQUEST_BYTES:
        return _json(413, {"error": f"expected a request of up to {REQUEST_BYTES} bytes"})
    try:
        asked = msgspec.json.decode(await request.body(), type=allowed[name].asked)
    except UNDECODABLE as error:
        return _json(400, {"error": str(error)})
    try:
        return _json(200, {"text": await run_in_threadpool(allowed[name].act, asked)})
    except SkinError as error:
        return _json(409, {"error": str(error)})


def _time_s(request: Request, name: str, default: float) -> float:
    """Return a time of the query; the default without, or for what is no number."""
    try:
        return float(request.query_params.get(name, default))
    except ValueError:
        return default


def _json(status: int, content: Any) -> Response:
    return Response(msgspec.json.encode(content), status_code=status, media_type="application/json")
