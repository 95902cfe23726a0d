"""The code in docs/client.md and in the READMEs runs as it stands."""

import importlib.util
import re
from itertools import islice
from types import SimpleNamespace
from typing import Any

import pytest

from canskin.errors import InputError
from tests.client.helpers import Chain
from tests.documents import block

HAS_APPLICATION = importlib.util.find_spec("skin") is not None
needs_application = pytest.mark.skipif(not HAS_APPLICATION, reason="NOT TESTED: the application is not installed")


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("code", "says"),
    [
        (block("README.md", "canskin.connect"), "0.500 N at (0.002, -0.004, 0.0): cup"),
        (block("client/README.md", "canskin.connect"), "cup [0.5"),
        (block("docs/client.md", "canskin.connect"), "0.500 N at 2.0, -4.0, 0.0 mm: cup"),
    ],
)
def test_reading_of_a_running_skin(code: str, says: str, endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    chain = Chain(endpoint)
    chain.start()
    few = code.replace("500", "20").replace(" in skin:", " in islice(skin, 20):")
    try:
        exec(few.replace("connect()", f'connect("{endpoint}")'), {"islice": islice})  # noqa: S102
    finally:
        chain.close()
    assert says in capsys.readouterr().out


@needs_application
@pytest.mark.slow
def test_a_skin_without_services(capsys: pytest.CaptureFixture[str]) -> None:
    exec(block("docs/client.md", "canskin.simulate"), {})  # noqa: S102
    assert re.fullmatch(r"\d+ 0\.\d+ golf-ball\n", capsys.readouterr().out)


@needs_application
@pytest.mark.slow
def test_solver_and_classifier_on_arrays(capsys: pytest.CaptureFixture[str]) -> None:
    exec(block("docs/client.md", "Reconstructor("), {})  # noqa: S102
    peak_n, label = capsys.readouterr().out.split(maxsplit=1)
    assert float(peak_n) == pytest.approx(0.01, rel=0.2)
    assert label.strip()


@needs_application
def test_images_of_codes_that_change(capsys: pytest.CaptureFixture[str]) -> None:
    exec(block("docs/client.md", "reconstruct("), {})  # noqa: S102
    peak_n, error_n = map(float, capsys.readouterr().out.split())
    assert peak_n == pytest.approx(0.01, rel=0.02)
    assert error_n < 0.0002


def test_a_program_is_the_source_of_sums() -> None:
    import numpy as np

    from canskin.messages import MEASUREMENT, CycleMeasurement

    names: dict[str, Any] = {}
    exec(block("docs/client.md", "def publish"), names)  # noqa: S102
    sent: list[tuple[object, CycleMeasurement]] = []
    fabric = SimpleNamespace(publish=lambda *message: sent.append(message))
    names["publish"](fabric, 241, np.array([3, -4]), np.array([True, False]), "f")
    ((topic, made),) = sent
    assert topic is MEASUREMENT
    assert (made.sync_counter, made.valid, np.frombuffer(made.sums, "<i4").tolist()) == (1, b"\1\0", [3, -4])


def test_simulation_without_the_application_is_one_clear_error(monkeypatch: pytest.MonkeyPatch) -> None:
    import canskin

    monkeypatch.setattr("canskin.application.entry_points", lambda **_selected: ())
    with pytest.raises(InputError, match=r"needs the application 'canskin'.*canskin.connect"):
        canskin.simulate()
