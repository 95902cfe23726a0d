"""Connections over a real fabric on loopback, with stand-ins for the services."""

import itertools
import subprocess
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

import canskin
from canskin.connection import ConnectedSkin
from canskin.fabric import Fabric, Mailbox
from canskin.messages import MARK, Mark
from canskin.skin import Skin
from tests.client.helpers import Chain, await_peers
from tests.processes import PATIENCE_S


@pytest.fixture
def chain(endpoint: str) -> Iterator[Chain]:
    made = Chain(endpoint)
    yield made
    made.close()


@contextmanager
def impatient(chain: Chain) -> Iterator[Skin]:
    """Connect, and once the gateway is known, wait for nothing for long."""
    with canskin.connect(chain.endpoint, "palm", timeout_s=PATIENCE_S) as skin:
        assert isinstance(skin, ConnectedSkin)
        with skin._came:
            assert skin._came.wait_for(lambda: "gateway" in skin.health.services, PATIENCE_S)
        skin._timeout_s = skin._hub._timeout_s = 0.1
        yield skin


def test_frames_of_a_running_skin(chain: Chain) -> None:
    chain.start()
    with canskin.connect(chain.endpoint, timeout_s=PATIENCE_S) as skin:
        assert (skin.layout.name, skin.layout.rows, skin.layout.sending) == ("palm", 4, "synchronous")
        frames = skin.frames(queue=1000)
        first = [next(frames) for _ in range(10)]
        assert all(a.cycle < b.cycle for a, b in itertools.pairwise(first))
        assert frames.lost == 0
        # The stand-in sends all at once: a measurement may come after its image.
        newest = next(frame for frame in skin if frame.sums.size)
        assert newest.cycle > first[0].cycle
        assert newest.label == "cup"
        assert newest.sums.tolist() == [10, 20, 30, 40]
        assert skin.latest(float("inf")).cycle >= newest.cycle
        health = skin.health
        assert "gateway" in health.services
        assert health.gateway is not None
        assert health.frames >= 10
        assert health.refused == 0
    assert len(list(frames)) <= 1000  # what was in the queue; the iteration has ended


def test_a_gateway_with_another_layout_is_asked_for_its_description(chain: Chain) -> None:
    chain.start()
    with canskin.connect(chain.endpoint, timeout_s=PATIENCE_S) as skin:
        assert next(frame for frame in skin if frame.sums.size).cycle > 0
        chain.fingerprint = "fedcba9876543210"
        assert next(frame for frame in skin if skin.layout.fingerprint == chain.fingerprint).cycle > 0
        assert next(frame for frame in skin if frame.sums.size).cycle > 0


def test_a_closed_skin_says_so(chain: Chain) -> None:
    skin = canskin.connect(chain.endpoint, timeout_s=PATIENCE_S)
    skin.close()
    with pytest.raises(canskin.BusError, match="closed"):
        skin.tare()
    with pytest.raises(canskin.BusError, match="closed"):
        skin.latest()
    assert list(skin) == []


@pytest.mark.heavy
def test_a_program_that_closes_nothing_ends(chain: Chain) -> None:
    program = f"import canskin; print(canskin.connect('{chain.endpoint}', timeout_s={PATIENCE_S}).layout.name)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )
    assert (done.returncode, done.stdout) == (0, "palm\n"), done.stderr


@pytest.mark.parametrize("timeout_s", [float("nan"), 0.0, -1.0, "x"])
def test_a_timeout_that_is_none_is_named(timeout_s: Any) -> None:
    with pytest.raises(canskin.InputError, match="timeout_s: expected seconds above 0"):
        canskin.connect(timeout_s=timeout_s)


def test_tare_tells_success_and_raises_otherwise(chain: Chain) -> None:
    with canskin.connect(chain.endpoint, timeout_s=PATIENCE_S) as skin:
        with pytest.raises(canskin.RunError, match="it is touched"):
            skin.tare()
        assert skin.tare(force=True) == "zero measured"
        assert skin.tare(region=(0, 1, 2, 3)) == "zero measured"
        with pytest.raises(canskin.InputError, match=r"region 0,0,4,3: expected .* rows of 0 to 3"):
            skin.tare(region=(0, 0, 4, 3))
    assert chain.tares == [False, True, (0, 1, 2, 3)]


@pytest.mark.heavy
def test_marks_reach_a_recorder_and_are_refused_without(chain: Chain) -> None:
    with canskin.connect(chain.endpoint, timeout_s=PATIENCE_S) as skin:
        with pytest.raises(canskin.InputError, match="expected printable text of up to 60"):
            skin.mark("cup\n")
        boxes: list[Mailbox[Mark]] = []
        recorder = Fabric("palm", "recorder", chain.endpoint, prepare=lambda fabric: boxes.append(fabric.mailbox(MARK)))
        (marks,) = boxes
        skin.mark("cup")
        skin.mark("")
        assert [marks.get(PATIENCE_S), marks.get(PATIENCE_S)] == [Mark(label="cup"), Mark(label="")]
        recorder.close()
    with pytest.raises(canskin.BusError, match="closed"):
        skin.mark("cup")
    with (
        impatient(chain) as skin,
        pytest.raises(canskin.BusError, match=r"no recorder of skin 'palm' is at .*: start 'skin record"),
    ):
        skin.mark("cup")


@pytest.mark.heavy
def test_silence_names_the_service_that_is_missing(chain: Chain) -> None:
    with (
        impatient(chain) as skin,
        pytest.raises(
            canskin.BusError, match=r"no image of skin 'palm' .* found .*gateway.*: start 'skin reconstruct'"
        ),
    ):
        skin.latest()


def test_an_absent_hub_and_a_wrong_address_are_named(endpoint: str) -> None:
    with pytest.raises(canskin.BusError, match=rf"no hub at {endpoint}") as refused:
        canskin.connect(endpoint, timeout_s=0.2)
    assert "ZError" not in "".join(traceback.format_exception(refused.value))
    with pytest.raises(canskin.BusError, match=r"expected an endpoint such as tcp/127.0.0.1:7447, got 'palm.local'"):
        canskin.connect("palm.local")


def test_a_skin_that_is_not_there_is_told_with_those_that_are(chain: Chain, one_look: None) -> None:
    with pytest.raises(canskin.BusError, match=r"no skin 'hand' at .*, found 'palm'"):
        canskin.connect(chain.endpoint, "hand", timeout_s=PATIENCE_S)
    other = Fabric("hand", "gateway", chain.endpoint)
    await_peers(chain.gateway, "hand/gateway")
    with pytest.raises(canskin.BusError, match=r"several skins at .*: 'hand', 'palm'; expected the name of one"):
        canskin.connect(chain.endpoint, timeout_s=PATIENCE_S)
    other.close()
    with canskin.connect(chain.endpoint, "palm", timeout_s=PATIENCE_S) as skin:
        assert skin.layout.name == "palm"


@pytest.mark.heavy
def test_a_hub_without_a_skin(endpoint: str, one_look: None) -> None:
    hub = Fabric("palm", "demo", endpoint, hub=True)
    with pytest.raises(canskin.BusError, match=r"no skin at .*, found demo of 'palm': is 'skin gateway' running"):
        canskin.connect(endpoint, timeout_s=PATIENCE_S)
    hub.close()
