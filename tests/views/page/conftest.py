"""The page in a real browser, and stand-ins for the services that it shows."""

import asyncio
import itertools
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import msgspec
import pytest
import uvicorn

from canskin.errors import RunError
from canskin.fabric import Fabric
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, TRUTH
from health.snapshot import Pictures, PlaybackState, RecorderState, Snapshot
from skin.layout import Layout
from tests.browser import Browser, chromium
from views.page.actions import Action, Play, Record, SetMark, Tare
from views.page.app import Page, build_app
from views.page.command import server_config
from views.page.guard import Access
from views.page.shown import Live, Shown


def only(shown: Shown, actions: Mapping[str, Action] | None = None) -> Callable[[], Mapping[str, Page]]:
    """Return the pages of a server that shows nothing else."""
    pages = {shown.layout.name: Page(shown, actions)}
    return lambda: pages


class Chain:
    """Stands for the services: publishes a small skin's messages 50 times a second."""

    def __init__(self, messages: Any, hub: Fabric, endpoint: str) -> None:
        self.images, self.truths, self.contacts, self.doubtful = True, True, False, False
        self.invalid: tuple[int, ...] = ()
        self.gateway: dict[str, Any] = {}
        self.label: dict[str, Any] = {}
        self.force_n, self.varies = 0.01, False
        self.fingerprint = messages.layout.phi().fingerprint
        self._messages, self._hub = messages, hub
        self.reconstructor = Fabric(messages.layout.name, "reconstructor", endpoint, fingerprint=self.fingerprint)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def force_of(self, cycle: int) -> float:
        """Return the peak of a cycle's forces, newtons."""
        return self.force_n * (1 + cycle % 100 / 100 * self.varies)

    def _run(self) -> None:
        for cycle in itertools.count(1):
            sync_s, pixels = time.monotonic(), self._messages.grid(self.force_of(cycle))
            of_cycle = {"cycle": cycle, "sync_s": sync_s}
            name = {"label": f"object-{cycle}"} if self.varies else {}
            if self.truths:
                self._hub.publish(TRUTH, self._messages.truth(true=pixels, **name, **of_cycle))
            if self.images:
                self._hub.publish(IMAGE, self._messages.image(invalid=self.invalid, pixels=pixels, **of_cycle))
            if self.contacts:
                total = {"force_n": float(pixels.sum())} if self.varies else {}
                self._hub.publish(CONTACTS, self._messages.contacts(doubtful=self.doubtful, **total, **of_cycle))
            self._hub.publish(LABEL, self._messages.label(**self.label, **name, **of_cycle))
            self._hub.publish(GATEWAY, self._messages.gateway(cycles=cycle, **self.gateway))
            if self._stop.wait(0.02):
                return

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.reconstructor.close()


class ShownLive(Live):
    """A running skin whose snapshots also show what a test sets."""

    def __init__(self, layout: Layout, fabric: Fabric) -> None:
        super().__init__(layout, fabric)
        self.shows: dict[str, RecorderState | PlaybackState | None] = {}

    def snapshot(self) -> tuple[Snapshot, Pictures]:
        snapshot, pictures = super().snapshot()
        return msgspec.structs.replace(snapshot, **self.shows), pictures


class Doer:
    """Stands for what the page can ask for: notes each request, and refuses as the services do."""

    def __init__(self, live: ShownLive) -> None:
        self.asked: list[Any] = []
        self._live = live

    def actions(self, *names: str) -> dict[str, Action]:
        all_ = {"tare": Tare, "record": Record, "mark": SetMark, "play": Play}
        return {name: Action(all_[name], self._do) for name in names}

    def _do(self, asked: Any) -> str:
        self.asked.append(asked)
        match asked:
            case Tare(force=False, region=None):
                raise RunError("something touches the skin; by force, what touches it becomes part of the zero")
            case Record(on=on):
                self._live.shows["recorder"] = RecorderState(path="palm.mcap", since_time_s=time.time()) if on else None
                return "recording to palm.mcap" if on else "12 messages in palm.mcap"
            case SetMark() if not self._live.shows.get("recorder"):
                raise RunError("nothing is recorded")
            case Play():
                changed = {name: each for name in asked.__struct_fields__ if (each := getattr(asked, name)) is not None}
                self._live.shows["playback"] = msgspec.structs.replace(self._live.shows["playback"], **changed)
        return "done"


class _Server(uvicorn.Server):
    """Leaves no connection open: a browser may connect while the server ends, or take more time to close."""

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        await super().shutdown(sockets)
        for connection in list(self.server_state.connections):
            connection.transport.abort()
        await asyncio.sleep(0)  # the transports close


class Server:
    """The page's server in this process, on a port that stays the same when it is started again."""

    def __init__(self, live: ShownLive) -> None:
        self.live, self.doer, self.access = live, Doer(live), Access()
        self.actions = self.doer.actions("tare", "record", "mark")
        self.port = 0
        self.start()

    def start(self) -> None:
        listener = socket.create_server(("127.0.0.1", self.port))
        self.port = listener.getsockname()[1]
        self.pages = {self.live.layout.name: Page(self.live, self.actions)}
        self._server = _Server(server_config(build_app(lambda: self.pages, self.access)))
        self._thread = threading.Thread(target=self._server.run, args=([listener],))
        self._thread.start()

    @property
    def address(self) -> str:
        """The address of the page, as the viewer logs it."""
        return f"http://127.0.0.1:{self.port}/?token={self.access.token}"

    def stop(self) -> None:
        self._server.should_exit = True
        self._thread.join()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with chromium(tmp_path_factory.mktemp("chromium")) as browser:
        yield browser


@pytest.fixture
def chain(messages: Any, hub: Fabric, endpoint: str) -> Iterator[Chain]:
    chain = Chain(messages, hub, endpoint)
    yield chain
    chain.close()


@pytest.fixture
def server(messages: Any, chain: Chain, endpoint: str) -> Iterator[Server]:
    fabric = Fabric(messages.layout.name, "viewer", endpoint)
    server = Server(ShownLive(messages.layout, fabric))
    yield server
    server.stop()
    fabric.close()


@pytest.fixture
def page(browser: Browser, server: Server) -> Browser:
    browser.complaints.clear()
    browser.open(server.address)
    browser.until(lambda: "golf ball" in browser.text("#object"), "no label was shown")
    return browser
