"""The health check: a service that works, one that does not, and one that is not there."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest

from canskin.fabric import Fabric
from canskin.messages import IMAGE, LABEL, MEASUREMENT, Topic
from health.alive import main, trouble
from tests.messages import image, label, measurement
from tests.processes import PATIENCE_S

ALIVE = str(Path(sys.executable).with_name("skin-alive"))
Message = tuple[Topic, msgspec.Struct]
ONE_OF_TWO, NONE_OF_TWO = b"\x00\x01", b"\x00\x00"


@pytest.fixture(autouse=True)
def much_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PATIENCE_S", "WORK_S"):
        monkeypatch.setattr(f"health.alive.{name}", PATIENCE_S)


@contextmanager
def hub(endpoint: str, *services: str, messages: tuple[Message, ...] = ()) -> Iterator[list[str]]:
    """Run services of the skin "palm" that send `messages` again and again; yield the names that came and went."""
    stop, seen = threading.Event(), list[str]()
    fabrics = [Fabric("palm", name, endpoint, hub=not place) for place, name in enumerate(services)]
    fabrics[0].watch(lambda name, _alive: seen.append(name))

    def send() -> None:
        while not stop.wait(0.01):
            for message in messages:
                fabrics[0].publish(*message)

    sender = threading.Thread(target=send)
    sender.start()
    yield seen
    stop.set()
    sender.join()
    for fabric in reversed(fabrics):
        fabric.close()


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("asked", "status"), [(["viewer"], 0), (["viewer", "palm"], 0), (["viewer", "hand"], 1), (["recorder"], 1)]
)
def test_service_is_found_whatever_the_name_of_its_skin(
    asked: list[str],
    status: int,
    endpoint: str,
    request: pytest.FixtureRequest,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    service, *skin = asked
    monkeypatch.setattr(sys, "argv", ["skin-alive", service, endpoint, *skin])
    if status:
        request.getfixturevalue("one_look")
    with hub(endpoint, "gateway", "viewer"):
        capsys.readouterr()
        assert main() == status
        told = capsys.readouterr().err
    assert told == f"skin-alive: {service} is not there [service-absent]\n" * status


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("service", "works", "idles"),
    [
        ("gateway", (MEASUREMENT, measurement(valid=ONE_OF_TWO)), (MEASUREMENT, measurement(valid=NONE_OF_TWO))),
        ("nodes", (MEASUREMENT, measurement(valid=ONE_OF_TWO)), (MEASUREMENT, measurement(valid=NONE_OF_TWO))),
        ("reconstructor", (IMAGE, image(valid=ONE_OF_TWO)), (IMAGE, image(valid=NONE_OF_TWO))),
        ("classifier", (LABEL, label(valid_sums=9)), (LABEL, label(valid_sums=9, blind=True))),
    ],
)
def test_a_service_is_healthy_while_its_messages_tell_of_measured_blocks(
    service: str, works: Message, idles: Message, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {"gateway", service}
    with hub(endpoint, *sorted(names), messages=(works,)) as seen:
        assert trouble(service, endpoint) == ""
    assert set(seen) <= names  # nobody saw the check
    monkeypatch.setattr("health.alive.WORK_S", 0.3)
    with hub(endpoint, *sorted(names), messages=(idles,)):
        assert (
            trouble(service, endpoint) == f"{service} is there, but nothing tells of measured blocks [service-silent]"
        )


@pytest.mark.heavy
def test_wrong_call_and_hub_that_is_not_there_are_told(endpoint: str) -> None:
    for arguments, status, says in (([], 2, "expected SERVICE"), (["gateway", endpoint], 1, "no hub at")):
        done = subprocess.run([ALIVE, *arguments], capture_output=True, text=True, check=False)
        assert done.returncode == status
        assert says in done.stderr
