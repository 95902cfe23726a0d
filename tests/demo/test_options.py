"""What cannot be met is told before any process is started."""

import socket
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from demo.options import DemoOptions
from shell.touch_options import TouchOptions
from skin.layout import Bus, load_layout

LAYOUT = load_layout()


OWN = {each.name for each in fields(DemoOptions)}


def options(folder: Path, **changes: Any) -> DemoOptions:
    """Return options of a run; those that are not of the demo alone are of its touch."""
    own = {name: value for name, value in changes.items() if name in OWN}
    touch = TouchOptions(**{name: value for name, value in changes.items() if name not in OWN})
    return DemoOptions(**{"touch": touch, "picture": folder / "picture.png"} | own)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"seconds": 0.0}, "--seconds needs a number above 0"),
        ({"seconds": float("nan")}, "--seconds needs a number above 0"),
        ({"listen": "tcp/0.0.0.0:7447"}, "--listen tcp/0.0.0.0:7447: everybody on that network could .* or --insecure"),
        ({"seed": -1}, "--seed: expected 0 or more"),
        ({"port": -3}, "--port: expected 0 to 65535, got -3"),
        ({"port": 65536}, "--port: expected 0 to 65535, got 65536"),
        ({"objects": ["golf-ball", "nosuch"]}, "unknown object 'nosuch'"),
        ({"array": ["foo"]}, "--array is for a recording: give one with --input"),
        ({"full_scale": 0.0}, "--full-scale is for a recording"),
        ({"rate": 10.0}, "--rate is for a recording"),
        ({"defect": ["dead=0.1", "worn"]}, "--defect worn: expected KIND or KIND=AMOUNT"),
        ({"drift": ["whole:step"]}, "--drift whole:step: expected PLACE:COURSE:AMOUNT_N"),
        *(({"frozen": [text]}, f"--frozen {text}: expected BLOCK") for text in ("x", "128", "1:-1", "1:nan", "1:inf")),
        ({"input": Path("missing.npz")}, "no recording at 'missing.npz'"),
        ({"model": Path("mine.npz"), "classify": False}, "--model is for the classifier"),
        ({"picture": Path("/proc/x.png")}, "/proc/x.png: cannot write the picture there"),
    ],
)
def test_option_that_cannot_be_used_is_told(changes: dict[str, Any], says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        options(tmp_path, **changes).check(LAYOUT)


def test_a_skin_whose_zero_drifts_has_a_zero_to_measure(tmp_path: Path) -> None:
    assert not options(tmp_path).has_zero_errors(LAYOUT)
    assert options(tmp_path, drift=["whole:ramp:0.001"]).has_zero_errors(LAYOUT)


def test_broken_recording_and_its_options_are_told(tmp_path: Path) -> None:
    broken, good = tmp_path / "broken.npz", tmp_path / "good.npz"
    broken.write_bytes(b"PK\x03\x04 no archive")
    np.savez(good, one=np.ones((3, 8, 8)))
    for changes in ({"input": broken}, {"input": good, "array": ["two"]}):
        with pytest.raises(InputError, match=r"broken\.npz|no array 'two'"):
            options(tmp_path, **changes).check(LAYOUT)
    with pytest.raises(InputError, match=r"--full-scale\) needs a number above 0"):
        options(tmp_path, input=good, full_scale=0.0).check(LAYOUT)
    options(tmp_path, input=good, full_scale=4.0, array=["one"]).check(LAYOUT)


def test_port_in_use_is_told_but_not_without_the_page(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} of .* is in use"):
            options(tmp_path, port=port).check(LAYOUT)
        options(tmp_path, port=port, view=False).check(LAYOUT)
    options(tmp_path, port=0).check(LAYOUT)


def test_buses_of_several_bit_rates_are_refused(tmp_path: Path) -> None:
    buses = [Bus(name="quick", nodes=16), Bus(name="slow", nodes=16, bitrate=125_000)]
    with pytest.raises(InputError, match="the same bit rates"):
        options(tmp_path).check(msgspec.structs.replace(LAYOUT, bus=buses))
