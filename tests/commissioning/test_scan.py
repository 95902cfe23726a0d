"""``skin scan``: what it lists, and how it ends."""

import json
import sys
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from bus import options
from bus.link import Send
from commissioning import scan_command, talk
from commissioning.scan import Scan
from dbc.canopen import HEARTBEAT_BASE, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, SYNC_COB_ID
from dbc.frame import Frames, frames
from tests.bus.harness import frame
from tests.processes import Verb

DRIVE = 5
SEGMENT = b"\x60" + bytes(7)


def scan_beside(send: Send, take: Callable[[Scan, float], None]) -> Scan:
    """Return a scan that is done; `take` is called in each turn of 10 ms."""
    scan, now_s = Scan(send, 1_000_000, 0.0, listen_s=0.1), 0.0
    while not scan.done and now_s < 60:
        now_s += 0.01
        take(scan, now_s)
        scan.tick(now_s)
    return scan


def test_a_node_that_another_master_always_asks_is_listed_as_busy() -> None:
    sent: list[int] = []
    scan = scan_beside(
        lambda burst: sent.extend(burst["can_id"].tolist()) or len(burst),
        lambda scan, now_s: scan.take(frame(SDO_REQUEST_BASE + DRIVE, SEGMENT), now_s),
    )
    assert scan.done
    assert SDO_REQUEST_BASE + DRIVE not in sent
    assert {node_id: each.is_busy for node_id, each in scan.nodes.items()} == {DRIVE: True}


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ("8000100000000006", "object 1000h:0: abort 06000000h"),
        ("8000100001000405", "no answer to object 1000h:0 but abort 05040001h, command"),
        ("4318100001000000", "no answer to object 1000h:0 but 4318100001000000, which is of object 1018h:0"),
        ("4f00100001", "no answer to object 1000h:0 but 4F00100001, which has 5 bytes, not 8"),
        ("4200100092010200", ""),
    ],
)
def test_a_node_that_refuses_is_listed_with_its_last_answer(answer: str, says: str) -> None:
    asked: list[bytes] = []

    def send(burst: Frames) -> int:
        asked.extend(each["data"].tobytes() for each in burst if each["can_id"] == SDO_REQUEST_BASE + DRIVE)
        return len(burst)

    def take(scan: Scan, now_s: float) -> None:
        if now_s < 0.015:
            scan.take(frame(HEARTBEAT_BASE + DRIVE, b"\5"), now_s)
        if asked and asked.pop()[1:3] == b"\0\x10":
            scan.take(frame(SDO_RESPONSE_BASE + DRIVE, bytes.fromhex(answer)), now_s)

    node = scan_beside(send, take).nodes[DRIVE]
    if says:
        assert (node.device_type, node.refusal) == (None, says)
    else:
        assert node.device_type == 0x00020192


class Heard:
    """A link on which frames wait when it is opened, and a drive is heard later."""

    def __init__(self, *arrived: Frames) -> None:
        self.arrived = [*arrived]

    def receive(self) -> Frames:
        return self.arrived.pop(0) if self.arrived else frames(0)

    def send(self, burst: Frames) -> int:
        return len(burst)

    def fileno(self) -> int:
        return sys.stdin.fileno()

    def close(self) -> None:
        self.arrived.clear()


class Clock:
    """Each look at the clock takes 10 ms; Ctrl-C comes after `turns` of the loop."""

    def __init__(self, turns: int) -> None:
        self.now_s, self.turns = 0.0, turns

    def monotonic(self) -> float:
        self.now_s += 0.01
        return self.now_s

    def install(self) -> "Clock":
        return self

    def is_set(self) -> bool:
        self.turns -= 1
        return self.turns < 0


@pytest.fixture
def run_scan(skin: Verb, monkeypatch: pytest.MonkeyPatch) -> Verb:
    def run(link: Heard, *arguments: str, turns: int = 10**6) -> tuple[int, str, str]:
        clock = Clock(turns)
        monkeypatch.setattr(options, "open_link", lambda *_, **__: link)
        monkeypatch.setattr(scan_command, "StopSignal", lambda: clock)
        for module in (scan_command, talk):
            monkeypatch.setattr(module, "time", clock)
        monkeypatch.setattr(talk, "select", SimpleNamespace(select=lambda *_: None))
        return skin("scan", "-i", "socketcan", "-c", "can0", *arguments)

    return run


def test_ctrl_c_shows_what_is_known(run_scan: Verb) -> None:
    beat = frame(HEARTBEAT_BASE + DRIVE, b"\x05")
    code, out, told = run_scan(Heard(frames(0), beat, frame(SYNC_COB_ID)), turns=8)
    assert code == 0
    assert "heartbeat of 5" in out
    assert "stopped before the scan was done" in told


@pytest.mark.parametrize("rate_hz", [100.0, 0.0])
def test_one_producer_beside_sync_may_be_one_beside_a_gateway(
    rate_hz: float, capsys: pytest.CaptureFixture[str]
) -> None:
    scan_command._show({"bus": "can0", "sync_rate_hz": rate_hz, "sync_producers": [3], "nodes": [], "identifiers": []})
    hint = "can0: if a gateway runs there, both produce SYNC: clear bit 30 of 1005h in node 3"
    assert (hint in capsys.readouterr().out.splitlines()) == (rate_hz > 0)


def test_what_came_while_the_links_were_opened_counts_for_no_rate(run_scan: Verb) -> None:
    waiting = np.concatenate([frame(SYNC_COB_ID)] * 50)
    code, out, _ = run_scan(Heard(waiting, frame(SYNC_COB_ID)), "--listen", "--seconds", "0.5", "--json")
    assert code == 0
    (found,) = json.loads(out)
    assert (found["sync_rate_hz"], found["identifiers"][0]["frames"]) == (2.0, 1)


@pytest.mark.parametrize("option", ["--bitrate", "--data-bitrate"])
def test_a_layout_has_the_bit_rates(option: str, run_scan: Verb) -> None:
    code, _, told = run_scan(Heard(), "--layout", "fd", option, "500000")
    assert code == 2
    assert "a layout has the rates" in told
