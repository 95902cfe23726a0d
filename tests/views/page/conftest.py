"""The page in a real browser, and stand-ins for the services that it shows."""

import itertools
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import uvicorn

from canskin.fabric import Fabric
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, TRUTH
from tests.browser import Browser, chromium
from views.page.app import build_app
from views.page.feed import Feed


class Chain:
    """Stands for the services: publishes a small skin's messages 50 times a second."""

    def __init__(self, messages: Any, hub: Fabric, endpoint: str) -> None:
        self.images, self.truths, self.contacts, self.doubtful = True, True, False, False
        self.invalid: tuple[int, ...] = ()
        self.gateway: dict[str, Any] = {}
        self.label: dict[str, Any] = {}
        self.fingerprint = messages.layout.phi().fingerprint
        self._messages, self._hub = messages, hub
        self.reconstructor = Fabric(messages.layout.name, "reconstructor", endpoint, fingerprint=self.fingerprint)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        for cycle in itertools.count(1):
            sync_s = time.monotonic()
            if self.truths:
                self._hub.publish(TRUTH, self._messages.truth(cycle, sync_s=sync_s))
            if self.images:
                image = self._messages.image(cycle, sync_s=sync_s, invalid=self.invalid)
                self._hub.publish(IMAGE, image)
            if self.contacts:
                self._hub.publish(CONTACTS, self._messages.contacts(cycle, doubtful=self.doubtful))
            self._hub.publish(LABEL, self._messages.label(**self.label))
            self._hub.publish(GATEWAY, self._messages.gateway(cycles=cycle, **self.gateway))
            if self._stop.wait(0.02):
                return

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.reconstructor.close()


class Server:
    """The page's server in this process, on a port that stays the same when it is started again."""

    def __init__(self, feed: Feed) -> None:
        self._feed = feed
        self.port = 0
        self.start()

    def start(self) -> None:
        listener = socket.create_server(("127.0.0.1", self.port))
        self.port = listener.getsockname()[1]
        config = uvicorn.Config(build_app(self._feed), log_config=None, timeout_graceful_shutdown=1)
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, args=([listener],))
        self._thread.start()

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
    feed = Feed(messages.layout)
    feed.join(fabric)
    server = Server(feed)
    yield server
    server.stop()
    fabric.close()


@pytest.fixture
def page(browser: Browser, server: Server) -> Browser:
    browser.complaints.clear()
    browser.open(f"http://127.0.0.1:{server.port}/")
    browser.until(lambda: "golf ball" in browser.text("#object"), "no label was shown")
    return browser
