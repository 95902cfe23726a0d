"""What a service tells of itself while its loop turns."""

import threading
import time
from contextlib import closing
from unittest import mock

import pytest

from canskin.errors import DeniedError
from canskin.fabric import Fabric
from canskin.messages import LABEL, SERVICES, ServiceStatus
from shell.pulse import PERIOD_S, Pulse
from tests import messages
from tests.processes import PATIENCE_S


@pytest.mark.heavy
def test_a_service_tells_once_a_second_what_it_made_took_and_lost(endpoint: str) -> None:
    now_s, heard, arrived = 0.0, list[ServiceStatus](), threading.Semaphore(0)
    with closing(Fabric("palm", "test", endpoint, hub=True)) as hub, closing(Fabric("palm", "solver", endpoint)) as own:
        hub.subscribe(SERVICES, lambda status: (heard.append(status), arrived.release()))
        slow, newest = own.mailbox(LABEL, 2), own.mailbox(LABEL, 1)
        pulse = Pulse(threading.Event(), lambda: now_s)
        pulse.beat(1)  # no hub yet
        pulse.fabric = own
        give_up_s = time.monotonic() + PATIENCE_S
        while slow.overrun < 3 and time.monotonic() < give_up_s:
            for _ in range(5):
                hub.publish(LABEL, messages.label())
            time.sleep(0.01)
            slow.get(0.0)
            newest.get(0.0)
        for made in range(10):
            now_s += 0.3 * PERIOD_S
            pulse.beat(made)
        assert arrived.acquire(timeout=PATIENCE_S)
        assert arrived.acquire(timeout=PATIENCE_S)
    first, second = heard
    assert (first.service, first.instance, first.missed) == ("solver", own.instance, 0)
    assert 3 <= first.overruns <= slow.overrun < slow.overrun + newest.overrun
    assert (first.made, second.made) == (3, 7)
    assert first.memory_bytes > 1 << 20
    assert 0 < first.processor_s <= second.processor_s


def test_a_role_that_may_tell_nothing_stops_no_service() -> None:
    now_s = 0.0
    pulse = Pulse(threading.Event(), lambda: now_s)
    pulse.fabric = mock.Mock(overruns=0, service="new", instance="1", clock_ns=(0, -1))
    pulse.fabric.missed.counts.return_value = {}
    pulse.fabric.publish.side_effect = DeniedError("may not put 'services'")
    now_s = 2 * PERIOD_S
    pulse.beat()
    assert pulse.fabric.publish.called
