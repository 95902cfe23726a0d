"""A skin has one gateway: a second is refused, also of two that start at once; a killed one keeps nobody out."""

import signal
import sys
import threading
from contextlib import closing
from pathlib import Path

import pytest

from canskin.errors import BusError
from canskin.fabric import Fabric
from tests.processes import PATIENCE_S, Processes

GATEWAY = """
import sys, threading
from canskin.fabric import Fabric
fabric = Fabric("palm", "gateway", sys.argv[1])
print("there", flush=True)
threading.Event().wait()
"""


@pytest.mark.parametrize("service", ["gateway", "replay"])
def test_a_second_gateway_of_a_skin_is_refused(endpoint: str, service: str) -> None:
    with closing(Fabric("palm", "gateway", endpoint, hub=True)) as first:
        with pytest.raises(BusError, match="skin 'palm' has a gateway already: stop that first, or give this skin an"):
            Fabric("palm", service, endpoint)
        assert [each.instance for each in first.peers()] == [first.instance]
        with closing(Fabric("hand", service, endpoint)), closing(Fabric("palm", "viewer", endpoint)):
            pass


@pytest.mark.parametrize("turn", range(3))
def test_of_gateways_that_start_at_once_one_stays(endpoint: str, turn: int) -> None:
    opened: list[Fabric] = []
    refused: list[BusError] = []
    together = threading.Barrier(4)

    def start() -> None:
        try:
            opened.append(Fabric("palm", "gateway", endpoint, prepare=lambda _: together.wait(PATIENCE_S)))
        except BusError as error:
            refused.append(error)

    with closing(Fabric("palm", "", endpoint, hub=True)):
        starting = [threading.Thread(target=start) for _ in range(4)]
        for each in starting:
            each.start()
        for each in starting:
            each.join()
        for fabric in opened:
            fabric.close()
    assert (len(opened), len(refused)) == (1, 3)


@pytest.mark.heavy
def test_a_gateway_that_was_killed_keeps_its_successor_not_out(tmp_path: Path, endpoint: str) -> None:
    with closing(Fabric("palm", "", endpoint, hub=True)), Processes(tmp_path) as started:
        started.start("gateway", sys.executable, "-c", GATEWAY, endpoint)
        started.await_words("gateway", "there")
        started.stop("gateway", signal.SIGKILL)
        started.start("successor", sys.executable, "-c", GATEWAY, endpoint)
        started.await_words("successor", "there")
