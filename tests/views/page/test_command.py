"""``skin view`` as a process: ports, readiness, and a quiet end."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from canskin.errors import InputError
from shell.skin_options import join
from skin.layout import changed, load_layout
from tests.layouts import layout_toml
from views.page.command import view

TOML = layout_toml(16, 16, name="palm")


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "skin", "view", *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ)
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.heavy
@pytest.mark.parametrize(("number", "is_named"), [(signal.SIGINT, True), (signal.SIGTERM, False)])
def test_port_0_is_told_the_skins_are_shown_and_signals_end_it_quietly(
    endpoint: str, tmp_path: Path, number: signal.Signals, *, is_named: bool
) -> None:
    layout = tmp_path / "palm.toml"
    layout.write_text(TOML)
    palm = load_layout(layout)
    hand = changed(palm, name="hand")
    with (
        closing(join(palm, "gateway", endpoint, hub=True)),
        running(*["--layout", str(layout)] * is_named, "--connect", endpoint, "--port", "0") as process,
    ):
        assert process.stderr is not None
        line = process.stderr.readline()
        assert line.startswith("viewer: web page at http://127.0.0.1:")
        address, _, token = line.split()[-1].partition("?token=")
        assert len(token) >= 32
        assert httpx.get(f"{address}api/state", timeout=240).json()["skin"] == "palm"
        with closing(join(hand, "gateway", endpoint)):  # comes later
            assert is_named or process.stderr.readline() == "viewer: skin 'hand' is shown\n"
            assert httpx.get(f"{address}api/skins", timeout=240).json() == ["palm", "hand"][: 2 - is_named]
        process.send_signal(number)
        out, err = process.communicate(timeout=240)
    assert (process.returncode, out, err) == (0, "", "")


@pytest.mark.heavy
def test_port_in_use_is_one_line_and_exit_2() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        with running("--port", str(taken.getsockname()[1])) as process:
            out, err = process.communicate(timeout=240)
    assert (process.returncode, out, err.count("\n")) == (2, "", 1)
    assert "is in use: give another with --port" in err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"port": 70000}, "--port: expected 0 to 65535, got 70000"),
        ({"host": "192.0.2.1", "port": 0}, "--host 192.0.2.1 --port 0: cannot listen there"),
        ({"host": "no such host"}, "--host no such host: cannot listen there"),
    ],
)
def test_address_that_cannot_be_used_is_one_line(
    options: dict[str, Any], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("views.page.command.StopSignal.install", lambda self: self)
    with pytest.raises(InputError, match=message) as caught:
        view(**options)
    assert "\n" not in str(caught.value)
