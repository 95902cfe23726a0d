"""``skin monitor`` in a terminal, and without one."""

import os
import pty
import select
import subprocess
import sys
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from canskin.fabric import Fabric
from canskin.messages import GATEWAY
from shell.skin_options import SkinOptions
from skin.layout import layout_text
from tests.health.helpers import Messages
from tests.processes import PATIENCE_S
from views.monitor.command import monitor


@contextmanager
def gateway(hub: Fabric, messages: Messages) -> Iterator[None]:
    """Stand for the gateway: tell the state of the buses."""
    over = threading.Event()

    def run() -> None:
        while not over.wait(0.02):
            hub.publish(GATEWAY, messages.gateway())

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@pytest.fixture
def options(hub: Fabric, messages: Messages, endpoint: str, tmp_path: Path) -> Iterator[SkinOptions]:
    layout = tmp_path / "palm.toml"
    layout.write_bytes(layout_text(messages.layout).encode())
    with gateway(hub, messages):
        yield SkinOptions(layout=layout, connect=endpoint)


@pytest.mark.heavy
def test_without_a_terminal_one_frame_is_printed_whole(
    options: SkinOptions, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("views.monitor.command.StopSignal.install", lambda self: self)
    monitor(of=options)
    out = capsys.readouterr().out
    assert "\x1b" not in out
    assert "…" not in out
    assert all(named in out for named in (" palm ", "left", "right", "monitor"))


@pytest.mark.heavy
def test_in_a_terminal_keys_are_heard_and_the_terminal_is_as_before_at_the_end(options: SkinOptions) -> None:
    control, terminal = pty.openpty()
    before = termios.tcgetattr(terminal)
    termios.tcsetwinsize(terminal, (24, 80))
    command = [sys.executable, "-m", "skin", "monitor", "--layout", str(options.layout), "--connect", options.endpoint]
    process = subprocess.Popen(command, stdin=terminal, stdout=terminal, stderr=terminal)
    try:
        read_until(control, b"right")
        assert not termios.tcgetattr(terminal)[3] & termios.ECHO
        os.write(control, b"s")
        read_until(control, b"memory")
        termios.tcsetwinsize(terminal, (30, 100))
        read_until(control, b"\x1b[30;1H")
        os.write(control, b"q")
        read_until(control, b"\x1b[?1049l")
        assert process.wait(PATIENCE_S) == 0
        assert termios.tcgetattr(terminal) == before
    finally:
        process.kill()
        process.wait()
        for each in (control, terminal):
            os.close(each)


def read_until(control: int, wanted: bytes) -> None:
    """Read what a terminal gets until `wanted` has come."""
    got = b""
    while wanted not in got:
        assert select.select([control], [], [], PATIENCE_S)[0], got
        got += os.read(control, 4096)
