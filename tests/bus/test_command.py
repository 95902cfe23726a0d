"""``skin bus`` as a person uses it."""

import json
import signal
import subprocess
import sys

import pytest

from tests.bus.harness import PATIENCE_S, burst, collect, linked


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "skin", "bus", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.heavy
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_it_says_that_it_is_ready_carries_frames_and_ends_quietly(how: int) -> None:
    process = start("left", "right", "--fault", "controller=a:*,loss_ratio=1", "--json")
    try:
        assert process.stderr is not None
        assert process.stderr.readline() == "bus: ready: left, right at 1000000 bit/s\n"
        with linked("a", "b", channel="right") as (a, _):
            a.send(burst(range(10)))
            collect(a, 10)
        process.send_signal(how)
        out, said = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, said) == (0, "")
    counts = json.loads(out)
    assert counts["left"]["accepted"] == 0
    assert (counts["right"]["transmitted"], counts["right"]["lost"]) == (10, 10)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        (["--bitrate", "1"], "bit rate of 10000 to 1000000 bit/s"),
        (["--data-bitrate", "1000"], "1000000 (the bit rate) to 8000000 bit/s, or 0 for no CAN FD"),
        (["--fault", "lost=1"], "loss_ratio"),
        (["--queue-size", "0"], "queue"),
        (["--restart-s", "nan"], "restart after 0 to 3600 s"),
        (["--restart-s", "inf"], "restart after 0 to 3600 s"),
        (["a/b"], "cannot name a bus"),
    ],
)
def test_wrong_input_is_one_line_and_status_2(arguments: list[str], what: str) -> None:
    process = start(*arguments)
    out, said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 2
    assert out == ""
    assert what in said
    assert said.count("\n") == 1
