"""``skin doctor``: what it finds with and without a hub, its exit codes, and wrong calls."""

import errno
import json
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from bus.interface import Interface, Timing
from bus.options import BusOptions
from canskin.errors import BusError
from canskin.fabric import Fabric
from canskin.keys import UNIX
from canskin.messages import GATEWAY, IMAGE, Fault, GatewayStatus, NodeFault
from commissioning import doctor_command
from health.alive import trouble
from health.causes import Cause
from shell.skin_options import SkinOptions
from skin.layout import parse_layout
from tests.bus.harness import interface, serving
from tests.layouts import SHIPPED, buses, layout_toml
from tests.messages import bus_state, gateway_status, image
from tests.processes import PATIENCE_S, Processes, Verb

TOML = layout_toml(8, 16, name="palm", bus=buses(2, 2))
PALM = parse_layout(TOML.encode(), "palm.toml")
#: Causes of a machine that is too busy for its skin.
OF_THE_MACHINE = {
    cause.code
    for cause in (
        Cause.HOST_LATE,
        Cause.SERVICE_DROPS,
        Cause.SYNC_REFUSED,
        Cause.NODE_LOSES,
        Cause.NODE_LATE,
        Cause.NODE_EMERGENCY,
    )
}

#: Skins of each kind: classic CAN, CAN FD, sums before the converters, steps, positions; with SKIN_LAYOUTS all that are
#: shipped.
KINDS = SHIPPED if "SKIN_LAYOUTS" in os.environ else ["default", "analogue", "steps-fd", "hand"]

Findings = dict[str, dict[str, Any]]


@pytest.fixture
def palm(tmp_path: Path, own_sockets: None) -> str:
    path = tmp_path / "palm.toml"
    path.write_text(TOML)
    return str(path)


@pytest.fixture
def examined(skin: Verb, endpoint: str, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, Findings]]:
    """Run ``skin doctor --json``; return the exit code, and the findings that are not of the host by their codes."""
    monkeypatch.setattr(doctor_command, "_host", lambda _: [])

    def run(*arguments: str) -> tuple[int, Findings]:
        code, out, _ = skin("doctor", "--connect", endpoint, "--json", *arguments)
        found = json.loads(out)
        assert found["is_well"] == (code == 0)
        assert all(each["text"] and each["mend"] for each in found["findings"])
        return code, {each["code"]: each for each in found["findings"]}

    return run


def test_without_hub_and_buses_each_is_named_with_its_command(
    palm: str, examined: Callable[..., tuple[int, Findings]]
) -> None:
    code, found = examined("--layout", palm)
    assert (code, list(found)) == (1, ["interface-lost", "hub-away"])  # a gateway waits for its buses
    assert "skin gateway" in found["hub-away"]["mend"]
    assert found["interface-lost"]["text"].startswith("bus0, bus1: no bus 'bus0'")
    assert found["interface-lost"]["mend"].startswith(f"'skin bus --layout {palm}'")
    assert "give --layout if" in examined()[1]["hub-away"]["mend"]


def test_a_bus_of_another_bit_rate_and_boards_that_are_not_there(
    palm: str, examined: Callable[..., tuple[int, Findings]]
) -> None:
    with serving("bus0", "bus1", bitrate=500_000):
        _, found = examined("--layout", palm)
    assert "it runs at 500000 bit/s, not 1000000" in found["interface-differs"]["text"]
    with serving("bus0", "bus1"):
        _, found = examined("--layout", palm)
    assert "all nodes never heard" in found["node-absent"]["text"]
    assert f"'skin scan --layout={palm} --connect=tcp/" in found["node-absent"]["mend"]
    assert f"'skin gateway --layout={palm}'" in found["hub-away"]["mend"]


@pytest.mark.parametrize(
    ("about", "level", "text", "mend"),
    [
        (interface(timing=Timing(500_000, 0.875)), "error", "its bit rate is 500000", "ip link set can0 down"),
        (interface(queue_frames=1), "warning", "room for 1 frames", "ip link set can0 txqueuelen"),
        (OSError(errno.ENODEV, "No such device"), "error", "no interface can0: No such device", "plug"),
    ],
)
def test_interfaces_of_the_kernel(
    about: Interface | OSError, level: str, text: str, mend: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read(_channel: str) -> Interface:
        if isinstance(about, OSError):
            raise about
        return about

    monkeypatch.setattr(doctor_command, "read_interface", read)
    (found,) = doctor_command._differences("can0", PALM.bus[0])
    assert found.level == level
    assert text in found.text
    assert found.mend.startswith(mend)
    assert "'" not in found.text


@contextmanager
def telling(endpoint: str, status: GatewayStatus, *others: str) -> Iterator[None]:
    """Let a gateway say all the time how its skin is, and a reconstructor send images."""
    from shell.skin_options import join

    stop = threading.Event()
    with closing(join(PALM, "gateway", endpoint, hub=True)) as gateway:

        def tell() -> None:
            cycle = 0
            while not stop.wait(0.02):
                cycle += 1
                gateway.publish(GATEWAY, status)
                if others:
                    gateway.publish(IMAGE, whole_image(cycle))

        sender = threading.Thread(target=tell)
        sender.start()
        kept = [join(PALM, name, endpoint) for name in others]
        try:
            yield
        finally:
            stop.set()
            sender.join()
            for each in kept:
                each.close()


def whole_image(cycle: int) -> Any:
    pixels, valid = bytes(4 * PALM.taxels.count), b"\1" * PALM.blocks
    return image(cycle, pixels=pixels, valid=valid, valid_sums=PALM.measurement.sums, sampled_mono_ns=cycle * 10**7)


def status_of(load_ratio: float, **changed: Any) -> GatewayStatus:
    states = [
        bus_state(line.name, nodes=[1, 2], nmt=b"\5\5", load_ratio=load_ratio, **(changed if not place else {}))
        for place, line in enumerate(PALM.bus)
    ]
    return gateway_status(100, buses=states)


def test_beside_a_gateway_nothing_is_sent_and_its_skin_is_judged(
    endpoint: str, examined: Callable[..., tuple[int, Findings]], monkeypatch: pytest.MonkeyPatch, own_sockets: None
) -> None:
    monkeypatch.setattr(doctor_command, "PATIENCE_S", PATIENCE_S)
    monkeypatch.setattr(doctor_command, "_look_at_buses", lambda *_: pytest.fail("the buses are the gateway's"))
    with telling(endpoint, status_of(load_ratio=0.01), "reconstructor", "classifier"):
        assert examined() == (0, {})
    with telling(endpoint, status_of(load_ratio=0.9, faults={2: NodeFault(Fault.OTHER_DEVICE, "1018h:2 was 1")})):
        code, found = examined()
    assert code == 1
    assert found.keys() == {"node-other-device", "bus-load-above-plan", "no-image", "service-absent"}
    assert "1018h:2 was 1" in found["node-other-device"]["text"]
    assert "load 90.0%, planned are" in found["bus-load-above-plan"]["text"]


def test_a_hub_without_gateway_is_an_error_and_a_gateway_that_hangs_too(
    palm: str, endpoint: str, examined: Callable[..., tuple[int, Findings]]
) -> None:
    with closing(Fabric("palm", "", endpoint, hub=True)):
        code, found = examined("--layout", palm)
        assert (code, found["gateway-absent"]["level"]) == (1, "error")
        with closing(Fabric("palm", "gateway", endpoint, fingerprint=PALM.phi().fingerprint)):
            code, found = examined()
    assert (code, list(found)) == (1, ["gateway-silent"])


def test_a_hub_that_hangs_is_to_be_ended_and_nobody_guesses_which_skin_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor_command, "_host", lambda _: [])
    monkeypatch.setattr(doctor_command, "_look_at_buses", lambda *_: pytest.fail("they may be those of who hangs"))
    with closing(socket.socket(socket.AF_UNIX)) as hung:
        hung.bind(str(tmp_path / "hub"))
        hung.listen()
        of = SkinOptions(connect=f"{UNIX}/{tmp_path / 'hub'}")
        _, (found,) = doctor_command.examine(of, BusOptions())
    assert (found.code, found.level) == ("hub-away", "error")
    assert "does not answer: it hangs" in found.text
    assert "kill -9" in found.mend


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["time", "-c", "can0"], "expected no CAN interface with 'skin doctor time'"),
        (["--seconds", "3"], "--seconds is for 'skin doctor time'"),
        (["--connect", "nowhere"], "expected an endpoint"),
        (["--layout", "no.toml"], "no.toml"),
        (["--layout", "steps", "-c", "a", "b"], "expected 4 channels"),
        (["--layout", "steps", "--skin", "other"], "--skin other"),
        (["-i", "socketcan", "-c", "can/0"], "expected an interface's name"),
        (["-i", "nonsense"], "got 'nonsense'"),
        (["everything"], "everything"),
    ],
)
def test_wrong_calls_are_one_line_and_exit_code_2(
    arguments: list[str], said: str, skin: Verb, endpoint: str, own_sockets: None
) -> None:
    given = arguments if "--connect" in arguments else [*arguments, "--connect", endpoint]
    code, _, told = skin("doctor", *given)
    assert code == 2
    assert said in told


def test_findings_are_told_worst_first(palm: str, endpoint: str, skin: Verb) -> None:
    code, out, _ = skin("doctor", "--layout", palm, "--connect", endpoint)
    lines = out.splitlines()
    levels = [line.partition(":")[0] for line in lines[:-1] if not line.startswith(" ")]
    assert code == 1
    assert levels == sorted(levels, key=["error", "warning", "info"].index)
    assert lines[-1] == "palm: 2 errors"


def images_come(endpoint: str) -> bool:
    try:
        return not trouble("reconstructor", endpoint)
    except BusError:  # no hub yet
        return False


@pytest.mark.slow
@pytest.mark.parametrize("layout", KINDS)
def test_nothing_is_wrong_with_a_healthy_skin_of_each_kind(
    layout: str, endpoint: str, tmp_path: Path, examined: Callable[..., tuple[int, Findings]], own_sockets: None
) -> None:
    """Whatever a busy machine does to a skin may be found. A reconstructor that is stopped then is found."""
    with Processes(tmp_path, SKIN_BUS_DIR=os.environ["SKIN_BUS_DIR"]) as running:
        of = ("--layout", layout)
        running.skin("bus", "bus", *of)
        running.await_words("bus", "ready")
        running.skin("gateway", "gateway", *of, "--listen", endpoint)
        running.skin("nodes", "nodes", *of, "--connect", endpoint, "--rest", "600")
        running.skin("reconstructor", "reconstruct", *of, "--connect", endpoint)
        running.until(lambda: images_come(endpoint), "images of measured blocks", 1.0)
        found = examined()[1]
        assert not {each for each in found if found[each]["level"] != "info"} - OF_THE_MACHINE
        running.send_signal("reconstructor", signal.SIGSTOP)
        try:
            # The hub forgets a service that it does not hear for a while.
            assert {"service-silent", "service-gone"} & examined()[1].keys()
        finally:
            running.send_signal("reconstructor", signal.SIGCONT)
