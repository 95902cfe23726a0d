"""The HTTP server: the page and its files, frames by WebSocket, state and history, and what the page asks for."""

import math
from collections.abc import Callable, Mapping
from importlib.resources import files
from typing import Any, Final

import msgspec
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import HTTPConnection, Request
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


class Page:
    """A skin or a recording that the server shows.

    Parameters
    ----------
    actions : mapping of str to Action, optional
        What the page may ask for; without them nothing.
    """

    def __init__(self, shown: Shown, actions: Mapping[str, Action] | None = None) -> None:
        self.shown, self.actions = shown, actions or {}
        self.stream = FrameStream(lambda: frame(*shown.snapshot()))
        self.hello = msgspec.json.encode(greeting(shown.layout, list(self.actions))).decode()


def build_app(pages: Callable[[], Mapping[str, Page]], access: Access | None = None) -> Starlette:
    """Return the application that shows skins or a recording.

    Paths: ``/`` the page of the only skin, or one that shows all side by side; ``/static`` its files; ``/ws`` a
    greeting as text, then frames (`views.page.wire`), and the page answers each frame with a text message;
    ``/api/state`` the snapshot as JSON; ``/api/history?after_s=T`` the moments of the last minutes
    (`views.page.history`); ``/api/frame?time_s=T`` the frame nearest to a time of them. POST ``/api/NAME`` with a
    request as JSON does what `views.page.actions` says, and answers with ``text``, what was done, or ``error``. Of
    several skins these paths are below ``/skins/SKIN/``; ``/api/skins`` has their names. ``/healthz``.

    Parameters
    ----------
    pages : callable
        Returns the pages by the name of the skin.
    access : Access, optional
        Whom the server serves; default: this machine, with a new token.
    """
    site = _Site(pages)
    of_a_skin = [
        Route("/", site.index),
        Route("/api/state", site.state),
        Route("/api/history", site.history),
        Route("/api/frame", site.frame),
        Route("/api/{name}", site.act, methods=["POST"]),
        WebSocketRoute("/ws", site.live),
    ]
    return Starlette(
        routes=[
            Route("/api/skins", site.skins),
            *of_a_skin,
            Mount("/skins/{skin}", routes=of_a_skin),
            Route(HEALTH, _health),
            Route("/static/colours.js", _colour_script),
            Mount("/static", StaticFiles(directory=STATIC)),
        ],
        middleware=[Middleware(Guard, access=access or Access())],
    )


class _Site:
    """Answers requests with the page of their skin."""

    def __init__(self, pages: Callable[[], Mapping[str, Page]]) -> None:
        self._pages = pages

    async def index(self, request: Request) -> Response:
        is_one = "skin" in request.path_params or len(self._pages()) == 1
        return FileResponse(f"{STATIC}/{'index' if is_one else 'skins'}.html", media_type="text/html")

    async def skins(self, _request: Request) -> Response:
        return _json(200, list(self._pages()))

    async def state(self, request: Request) -> Response:
        return _json(200, self._page(request).shown.snapshot()[0])

    async def history(self, request: Request) -> Response:
        return _json(200, self._page(request).shown.history(_time_s(request, "after_s", -math.inf)))

    async def frame(self, request: Request) -> Response:
        content = self._page(request).shown.frame(_time_s(request, "time_s", math.inf))
        if content is None:
            return _json(404, {"error": "nothing is kept of that time"})
        return Response(content, media_type="application/octet-stream")

    async def act(self, request: Request) -> Response:
        return await _act(request, self._page(request).actions)

    async def live(self, websocket: WebSocket) -> None:
        page = self._page(websocket)
        await websocket.accept()
        await websocket.send_text(page.hello)
        await serve_page(websocket, page.stream)

    def _page(self, connection: HTTPConnection) -> Page:
        """Return the page that a request names, or the only one."""
        there = self._pages()
        name = connection.path_params.get("skin", next(iter(there)) if len(there) == 1 else "")
        if name not in there:
            raise HTTPException(404, f"expected /skins/NAME/ with one of {', '.join(there) or 'no skin yet'}")
        return there[name]


async def _colour_script(_request: Request) -> Response:
    return Response(script(), media_type="text/javascript")


async def _health(_request: Request) -> Response:
    return _json(200, {"status": "ok"})


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
