"""The clock of another machine: what an exchange proves of it, and a process whose clock is another one."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from functools import partial

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canskin.errors import BusError
from canskin.fabric import Fabric
from canskin.messages import UNKNOWN_ERROR_NS
from canskin.skin_clock import DRIFT_RATIO, TIME, SkinClock, TimeReply, TimeRequest, machine, time_reply
from tests.processes import PATIENCE_S

#: time_namespaces(7): a process whose monotonic clock is 5000 s ahead.
AHEAD_NS = 5000 * 10**9
ELSEWHERE = ("unshare", "--map-root-user", "--time", "--monotonic", "5000")
#: Answers like a gateway until its input ends.
GATEWAY = """
import sys
from canskin.fabric import Fabric
from canskin.skin_clock import TIME, time_reply
fabric = Fabric("palm", "", sys.argv[1])
fabric.answer(TIME, lambda _, reply: reply(time_reply()))
print("there", flush=True)
sys.stdin.read()
fabric.close()
"""


def delays() -> st.SearchStrategy[int]:
    return st.integers(0, 50_000_000)


@given(
    ahead_ns=st.integers(-(10**15), 10**15),
    drift=st.floats(-DRIFT_RATIO / 2, DRIFT_RATIO / 2),
    exchanges=st.lists(st.tuples(delays(), delays(), st.integers(0, 10**10)), min_size=1, max_size=20),
)
def test_the_error_is_never_larger_than_told(
    ahead_ns: int, drift: float, exchanges: list[tuple[int, int, int]]
) -> None:
    now_ns = 0

    def there_ns() -> int:
        return now_ns + ahead_ns + round(drift * now_ns)

    clock = SkinClock(clock_ns=lambda: now_ns)
    for to_ns, fro_ns, rest_ns in exchanges:

        def ask(to_ns: int = to_ns, fro_ns: int = fro_ns) -> TimeReply:
            nonlocal now_ns
            now_ns += to_ns
            reply = TimeReply(there_ns(), "another")
            now_ns += fro_ns
            return reply

        clock.look(ask)
        now_ns += rest_ns
        offset_ns, error_ns = clock.known()
        assert abs(now_ns + offset_ns - there_ns()) <= error_ns + 2  # roundings
        assert clock.now_ns() == now_ns + offset_ns


def test_a_gateway_that_starts_again_elsewhere_has_another_clock() -> None:
    clock = SkinClock(clock_ns=lambda: 1000)
    clock.look(lambda: TimeReply(6000, "one"))
    assert clock.known() == (5000, 0)
    clock.look(lambda: TimeReply(9000, "another"))
    assert clock.known() == (8000, 0)
    clock.look(lambda: TimeReply(1000, machine()))
    assert clock.known() == (0, 0)


def test_without_an_answer_the_error_is_unknown() -> None:
    def ask() -> TimeReply:
        raise BusError("no service answers")

    clock = SkinClock(clock_ns=lambda: 1000)
    clock.look(ask)
    assert (clock.known(), clock.now_ns()) == ((0, UNKNOWN_ERROR_NS), 1000)


def test_on_the_gateways_machine_no_time_is_asked_for() -> None:
    assert SkinClock(of=machine()).known() == (0, 0)
    assert SkinClock(of="").known() == (0, UNKNOWN_ERROR_NS)


@pytest.fixture
def elsewhere(endpoint: str) -> Iterator[None]:
    if subprocess.run([*ELSEWHERE, "true"], check=False, capture_output=True).returncode:
        pytest.skip("NOT TESTED: a process with a clock of its own, for want of time namespaces")
    with subprocess.Popen(
        [*ELSEWHERE, sys.executable, "-c", GATEWAY, endpoint],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "there\n"
        yield


def test_a_process_elsewhere_is_known_to_its_bound(endpoint: str, request: pytest.FixtureRequest) -> None:
    with closing(Fabric("palm", "", endpoint, hub=True)) as hub:
        request.getfixturevalue("elsewhere")
        clock = hub.clock()
        while clock.known()[1] == UNKNOWN_ERROR_NS:  # the hub hears of the answerer a little later
            clock.look(partial(hub.ask, TIME, TimeRequest(), PATIENCE_S))
        offset_ns, error_ns = clock.known()
        assert abs(offset_ns - AHEAD_NS) <= error_ns
        assert abs(hub.clock_ns[0] - AHEAD_NS) <= hub.clock_ns[1]


def test_the_clock_is_followed(endpoint: str) -> None:
    looked = threading.Semaphore(0)
    with closing(Fabric("palm", "", endpoint, hub=True)) as hub:

        def answer(_request: object, reply: object) -> None:
            looked.release()
            reply(TimeReply(time_reply().mono_ns, "another"))  # type: ignore[operator]

        hub.answer(TIME, answer)
        hub.clock()
        assert looked.acquire(timeout=PATIENCE_S)
        assert looked.acquire(timeout=PATIENCE_S)
