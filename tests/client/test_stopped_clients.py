"""Clients that do not read any more, and a hub whose other clients notice nothing."""

import queue
import signal
import sys
import threading
from contextlib import suppress
from itertools import count
from pathlib import Path

import pytest

from canskin.fabric import Fabric
from canskin.messages import IMAGE, Image
from tests import messages
from tests.processes import Processes

#: Clients that stop: they silence a hub of one thread for more than a minute.
STOPPED = 24
PATIENCE_S = 60.0
TRIES = 120
#: Enough to fill the buffers of a connection in few messages.
PIXELS = bytes(60_000)
HUB = """
import sys, threading
from canskin.fabric import Fabric
fabric = Fabric("test", "hub", sys.argv[1], hub=True)
print("there", flush=True)
threading.Event().wait()
"""
#: Clients, whose hub gives them up when they have been silent for a second.
CLIENTS = """
import json, sys, threading, zenoh
kept = []
for number in range(int(sys.argv[2])):
    config = zenoh.Config()
    for key, value in {
        "mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False,
        "transport/link/tx/lease": 1000,
    }.items():
        config.insert_json5(key, json.dumps(value))
    session = zenoh.open(config)
    kept += [session, session.declare_subscriber("canskin/test/image", lambda _: None)]
    kept.append(session.liveliness().declare_token(f"canskin/test/alive/client/stopped-{number}"))
print("subscribed", flush=True)
threading.Event().wait()
"""


@pytest.mark.heavy
def test_clients_that_are_stopped_hold_nobody_up(tmp_path: Path, endpoint: str) -> None:
    with Processes(tmp_path) as started:
        started.start("hub", sys.executable, "-c", HUB, endpoint)
        started.await_words("hub", "there")
        sender, reader = Fabric("test", "sender", endpoint), Fabric("test", "reader", endpoint)
        heard: queue.Queue[Image] = queue.Queue()
        gone = threading.Event()

        def note(service: str, alive: bool) -> None:
            if service == "client" and not alive:
                gone.set()

        reader.subscribe(IMAGE, heard.put)
        reader.watch(note)
        cycles = count()

        def send() -> None:
            """Publish until a message comes: on a busy machine the fabric drops some."""
            for _ in range(TRIES):
                sender.publish(IMAGE, messages.image(next(cycles), pixels=PIXELS))
                with suppress(queue.Empty):
                    heard.get(timeout=PATIENCE_S / TRIES)
                    return
            pytest.fail(f"the reader got nothing for {PATIENCE_S:g} s")

        started.start("clients", sys.executable, "-c", CLIENTS, endpoint, str(STOPPED))
        started.await_words("clients", "subscribed")
        send()
        started.send_signal("clients", signal.SIGSTOP)
        try:
            while not gone.is_set():
                send()
            for _ in range(100):
                send()
        finally:
            started.stop("clients", signal.SIGKILL)
        assert sum(reader.missed.counts().values()) < next(cycles) / 10
        sender.close()
        reader.close()
