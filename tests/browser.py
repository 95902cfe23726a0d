"""Debian's chromium without a window, spoken to over its DevTools protocol."""

import base64
import itertools
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
from websockets.sync.client import ClientConnection, connect

from tests.processes import PATIENCE_S

CHROMIUM = shutil.which("chromium")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
)


class Browser:
    """One page of a headless chromium."""

    def __init__(self, socket: ClientConnection, patience_s: float = PATIENCE_S) -> None:
        self._socket, self._patience_s = socket, patience_s
        self._numbers = itertools.count(1)
        self.complaints: list[str] = []
        for domain in ("Runtime", "Log", "Page"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **parameters: Any) -> Any:
        """Call a method of the protocol; what the page complains of meanwhile is kept."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(self._patience_s))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            entry = message.get("params", {}).get("entry", {})
            if message["method"] == "Runtime.exceptionThrown" or entry.get("level") == "error":
                self.complaints.append(json.dumps(message["params"]))

    def open(self, address: str, width: int = 1280, height: int = 800) -> None:
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)
        self.call("Page.navigate", url=address)

    def ask(self, expression: str) -> Any:
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def text(self, selector: str) -> str:
        return str(self.ask(f"document.querySelector({json.dumps(selector)})?.innerText ?? ''"))

    def until(self, holds: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
        deadline_s = time.monotonic() + patience_s
        while not holds():
            if time.monotonic() > deadline_s:
                raise TimeoutError(f"{what}; the page says: {self.text('body')}; complaints: {self.complaints}")

    def wait(self, seconds: float) -> None:
        """Let the page go on for a while."""
        self.call(
            "Runtime.evaluate",
            expression=f"new Promise((done) => setTimeout(done, {1000 * seconds}))",
            awaitPromise=True,
        )

    def picture(self) -> bytes:
        """Return the whole page as PNG."""
        size = self.call("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": size["height"], "scale": 1}
        return base64.b64decode(
            self.call("Page.captureScreenshot", format="png", clip=clip, captureBeyondViewport=True)["data"]
        )

    def point(self, x: float, y: float) -> None:
        self.call("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y)


@contextmanager
def chromium(profile: Path, flags: Sequence[str] = FLAGS, patience_s: float = PATIENCE_S) -> Iterator[Browser]:
    assert CHROMIUM is not None
    command = [CHROMIUM, *flags, f"--user-data-dir={profile}", "about:blank"]
    with (profile / "stderr").open("w+") as said:
        process = subprocess.Popen(command, stderr=said, stdout=subprocess.DEVNULL)
        try:
            port_file = profile / "DevToolsActivePort"
            deadline_s = time.monotonic() + PATIENCE_S
            while not (port_file.exists() and port_file.read_text().count("\n")):
                assert process.poll() is None, (profile / "stderr").read_text()
                assert time.monotonic() < deadline_s, "chromium does not start"
                time.sleep(0.05)
            pages = httpx.get(f"http://127.0.0.1:{port_file.read_text().split()[0]}/json", timeout=PATIENCE_S).json()
            address = next(page["webSocketDebuggerUrl"] for page in pages if page["type"] == "page")
            with connect(address, max_size=None, ping_interval=None) as devtools:
                yield Browser(devtools, patience_s)
        finally:
            process.terminate()
            process.wait(PATIENCE_S)
