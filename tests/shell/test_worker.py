"""Which skins a worker serves, as gateways come, go and return."""

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from canskin.errors import InputError
from canskin.peers import Peer
from shell.service import ServiceThread, StopSignal
from shell.skin_options import SkinOptions
from shell.worker import GONE_S, _Worker, serve_skins
from tests.processes import PATIENCE_S


class Hall:
    """A worker whose service only waits, or raises what `faults` has for the skin."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self.begun: list[tuple[str | None, bool]] = []
        self.faults: dict[str | None, Exception] = {}
        self.worker = _Worker("solver", SkinOptions(connect="tcp/far:1"), self._serve)

    def _serve(self, of: SkinOptions, is_only: bool) -> None:
        self.begun.append((of.skin, is_only))
        if of.skin in self.faults:
            raise self.faults[of.skin]
        stop = StopSignal().install()
        while not stop.wait(0.01):
            pass

    def note(self, skin: str, *, is_there: bool = True, instance: str = "1", phi: str = "Φ") -> None:
        self.worker.note(Peer(skin, "gateway", instance, "1", phi), is_there)

    def look(self, passed_s: float = 1.0) -> set[str]:
        """Look once more; return the names of the threads that serve."""
        self.now_s += passed_s
        self.worker.look(self.now_s)
        threads = [each for each in threading.enumerate() if isinstance(each, ServiceThread)]
        return {each.name for each in threads if not each.stop.is_set()}

    def look_until_the_end_of(self, skin: str) -> None:
        self.look()
        self.worker._skins[skin].thread.join(PATIENCE_S)
        self.look()


@pytest.fixture
def hall() -> Iterator[Hall]:
    made = Hall()
    yield made
    made.worker.stop()


def test_every_skin_has_a_thread_from_its_gateways_first_sign_to_a_while_after_its_last(hall: Hall) -> None:
    assert not hall.look()
    hall.note("palm")
    hall.worker.note(Peer("page", "viewer", "1"), True)
    assert hall.look() == {"solver of palm"}
    hall.note("arm")
    assert hall.look() == {"solver of palm", "solver of arm"}
    assert hall.begun == [("palm", True), ("arm", False)]
    hall.note("arm", is_there=False)
    assert len(hall.look(GONE_S - 1)) == 2
    assert hall.look(2.0) == {"solver of palm"}
    hall.note("palm", is_there=False)
    hall.note("palm", instance="2")
    assert hall.look(GONE_S + 1) == {"solver of palm"}
    assert len(hall.begun) == 2
    hall.note("arm")
    hall.note("palm", instance="3", phi="Ψ")
    hall.note("palm", instance="2", is_there=False)  # the token of a gateway that was killed goes late
    hall.look()
    assert hall.look() == {"solver of palm", "solver of arm"}
    assert len(hall.begun) == 4


def test_a_skin_that_cannot_be_served_is_left_out_until_its_gateway_starts_anew(
    hall: Hall, capsys: pytest.CaptureFixture[str]
) -> None:
    hall.faults["arm"] = InputError("it has no model")
    hall.note("palm")
    hall.note("arm")
    hall.look_until_the_end_of("arm")
    for _ in range(3):
        assert "solver of palm" in hall.look()
    assert capsys.readouterr().err.count("solver: skin 'arm' is left out: it has no model\n") == 1
    del hall.faults["arm"]
    hall.note("arm", instance="2")
    hall.look()
    hall.look()
    assert hall.begun.count(("arm", False)) == 2


@pytest.mark.parametrize("error", [InputError("it has no model"), AssertionError("broken")])
def test_an_error_ends_the_worker_where_no_skin_is_left_or_the_program_is_wrong(hall: Hall, error: Exception) -> None:
    hall.faults["palm"] = error
    hall.note("palm")
    if isinstance(error, AssertionError):
        hall.note("arm")
    with pytest.raises(type(error), match=str(error)):
        hall.look_until_the_end_of("palm")


@pytest.mark.parametrize("of", [SkinOptions(skin="palm"), SkinOptions(layout=Path("steps"))])
def test_a_skin_that_is_named_is_served_alone(of: SkinOptions) -> None:
    served: list[tuple[SkinOptions, bool]] = []
    serve_skins("solver", of, lambda skin, is_only: served.append((skin, is_only)))
    assert served == [(of, True)]


def test_in_a_process_of_several_services_the_only_skin_is_served() -> None:
    served: list[bool] = []
    run = ServiceThread(
        "solver", lambda: serve_skins("solver", SkinOptions(), lambda _, is_only: served.append(is_only)), lambda: None
    )
    run.start()
    run.join(PATIENCE_S)
    assert served == [True]
