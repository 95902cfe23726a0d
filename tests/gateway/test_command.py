"""``skin gateway``: whose hub it runs, what it opens, and that it closes all of it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.options import BusOptions
from canskin.calibration_messages import CALIBRATION, ZERO, Question
from canskin.errors import BusError, InputError
from gateway import command
from shell import skin_options
from shell.service import StopSignal
from skin.calibration_file import encoded, new_calibration
from skin.layout import load_layout
from tests.layouts import STEPPED_SKIN


class Parts:
    """Stand-ins for buses, fabric and service; they keep what they are given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        parts = self
        self.calls: list[tuple[str, Any, Any]] = []
        self.closed: list[str] = []
        self.answered: list[Question] = []

        class Closing:
            proves_echo = True

            def __init__(self, name: str) -> None:
                self.name = name

            def answer(self, question: Question, handler: object) -> None:
                parts.answered.append(question)

            def watch_peers(self, changed: object) -> None:
                pass

            def close(self) -> None:
                parts.closed.append(self.name)

        def open_links(*given: object, **named: object) -> dict[int, Closing]:
            parts.calls.append(("links", given, named))
            return {0: Closing("bus0"), 1: Closing("bus1")}

        def fabric(*given: object, **named: object) -> Closing:
            parts.calls.append(("fabric", given, named))
            joined = Closing("fabric")
            named["prepare"](joined)
            return joined

        class Service:
            def __init__(self, *given: object, **named: object) -> None:
                parts.calls.append(("service", given, named))

            def run(self, stop: StopSignal, _beat: object) -> None:
                parts.calls.append(("run", (stop,), {}))
                raise KeyboardInterrupt

        monkeypatch.setattr(command, "open_links", open_links)
        monkeypatch.setattr(skin_options, "Fabric", fabric)
        monkeypatch.setattr(command, "GatewayService", Service)


@pytest.mark.parametrize(("connect", "hub"), [(None, "tcp/127.0.0.1:7447"), ("tcp/far:1", "tcp/far:1")])
def test_it_runs_the_hub_unless_it_joins_another(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], connect: str | None, hub: str
) -> None:
    parts = Parts(monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        command.gateway(listen="tcp/127.0.0.1:7447", connect=connect)
    (_, _, links), (_, place, options), (_, service, _), (_, (stop,), _) = parts.calls
    assert links["name"] == "gateway"
    assert place[1:] == ("gateway", hub)
    assert options["hub"] is (connect is None)
    assert options["fingerprint"] == service[0].phi.fingerprint
    assert links["stop"] is stop
    assert capsys.readouterr().err == "gateway: 2 buses, SYNC 200 Hz\n"
    assert sorted(parts.closed) == ["bus0", "bus1", "fabric"]


def test_options_of_the_bus_are_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    parts, options = Parts(monkeypatch), BusOptions("socketcan", ["can0"])
    with pytest.raises(KeyboardInterrupt):
        command.gateway(bus=options)
    assert parts.calls[0][1][1] is options


def test_it_answers_questions_about_its_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = Parts(monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        command.gateway()
    assert [each.name for each in parts.answered[-2:]] == [CALIBRATION.name, ZERO.name]


def test_a_calibration_of_another_skin_or_for_stepped_boards_is_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    parts = Parts(monkeypatch)
    path = tmp_path / "it.json"
    path.write_bytes(encoded(new_calibration(STEPPED_SKIN)))
    with pytest.raises(InputError, match="the calibration of another layout"):
        command.gateway(calibration=path)
    path.write_bytes(encoded(new_calibration(load_layout(), gains=np.ones(4096))))
    with pytest.raises(InputError, match="has no offsets of sums"):
        command.gateway(calibration=path)
    with pytest.raises(InputError, match="stepped boards measure their own offsets"):
        command.gateway(layout=Path("steps"), calibration=path)
    with pytest.raises(InputError, match="--keep-zero is for synchronous sending"):
        command.gateway(layout=Path("steps"), keep_zero=path)
    with pytest.raises(InputError, match=r"run\.mcap: expected a file for the zero that ends in \.json"):
        command.gateway(keep_zero=tmp_path / "run.mcap")
    assert not parts.calls


def test_the_zero_of_an_earlier_run_is_used_and_that_of_this_run_is_kept_at_the_end(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parts, path, skin = Parts(monkeypatch), tmp_path / "zero.json", load_layout()
    path.write_bytes(encoded(new_calibration(skin, offsets_n=np.full(1024, 0.01))))
    kept = path.stat().st_ino
    with pytest.raises(KeyboardInterrupt):
        command.gateway(keep_zero=path)
    assert "begins with the zero of" in capsys.readouterr().err
    assert path.stat().st_ino == kept  # there is no newer one
    calibration = parts.calls[2][2]["calibration"]
    status = calibration.status()
    assert (status.known_sums, status.offset_rms_n) == (1024, pytest.approx(0.01))
    monkeypatch.setattr(type(calibration), "keep_zero", lambda _: parts.closed.append("kept"))
    with pytest.raises(KeyboardInterrupt):
        command.gateway(keep_zero=path)
    assert "kept" in parts.closed


@pytest.mark.parametrize("listen", ["tcp/0.0.0.0:7447", "tcp/[::]:7447"])
def test_a_hub_for_a_network_without_keys_must_be_asked_for(monkeypatch: pytest.MonkeyPatch, listen: str) -> None:
    Parts(monkeypatch)
    with pytest.raises(InputError, match="or --insecure"):
        command.gateway(listen=listen)
    with pytest.raises(KeyboardInterrupt):
        command.gateway(listen=listen, insecure=True)


@pytest.mark.parametrize("wrong", [{"listen": "tcp/127.0.0.1:99999"}, {"connect": "nonsense"}])
def test_an_endpoint_is_looked_at_before_buses_are_waited_for(
    monkeypatch: pytest.MonkeyPatch, wrong: dict[str, str]
) -> None:
    parts = Parts(monkeypatch)
    with pytest.raises(BusError, match="expected an endpoint"):
        command.gateway(**wrong)  # type: ignore[arg-type]  # both are texts
    assert not parts.calls
