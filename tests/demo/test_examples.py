"""The example layouts of any shape, with both ways of sending."""

from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from dbc.contract import Contract
from docs.forearm import forearm
from nodes.simulated import Nodes
from nodes.steps.simulated import touched_frames
from reconstructor.imaging import CycleImager
from skin.ground_truth import in_contact
from skin.layout import Layout, load_layout, parse_layout
from skin.measured_sums import decode_measurement
from skin.psnr import psnr_db
from skin.sources import load_objects, step_rate_hz

TAXELS = {"mat": 100, "glove": 768, "hand": 261, "pad": 391, "forearm": 230}
#: Of the examples that are stepped as they come, when they send in cycles.
SUMS = {"mat": 64, "hand": 144}
FOLDER = Path(str(files("skin.layouts")))


def example(name: str, sending: str) -> Layout:
    """Return an example with a way of sending, as its document says."""
    tables: dict[str, Any] = msgspec.toml.decode((FOLDER / f"{name}.toml").read_bytes())
    if sending != tables.get("sending", "synchronous") and name != "forearm":
        tables["measurement"] = {"wiring": "board"} if sending == "steps" else {"sums": SUMS[name]}
    tables["sending"] = sending
    return parse_layout(msgspec.toml.encode(tables), f"{name}.toml", FOLDER)


@pytest.mark.parametrize("name", TAXELS)
def test_an_example_is_one_of_its_two_ways_of_sending(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    layout = load_layout(Path(name))
    assert layout == example(name, layout.sending)
    assert layout.taxels.there == TAXELS[name]


@pytest.mark.heavy
@pytest.mark.parametrize("name", TAXELS)
def test_images_are_10_db_better_than_the_sensor(name: str) -> None:
    layout = example(name, "synchronous")
    imager, phi, force_max_n = CycleImager(layout), layout.phi(), layout.taxels.force_max_n
    nodes = Nodes(layout, load_objects(layout, names=("golf-ball", "tuna-can"), seed=1, rest_s=0.1), seed=1)
    found = []
    for _ in range(round(6.0 * step_rate_hz(layout))):
        image_n = imager.solve(decode_measurement(nodes.measurement(nodes.sample()), phi))[0].ravel()
        truth = nodes.truth()
        true_n, sensed_n = (np.frombuffer(each, "<f4") for each in (truth.true, truth.sensor))
        if in_contact(true_n, force_max_n):
            there = phi.is_wired
            found.append([psnr_db(true_n[there], each[there], force_max_n) for each in (image_n, sensed_n)])
    image_db, sensor_db = np.mean(found, axis=0)
    assert len(found) > 200
    assert image_db > sensor_db + 10


@pytest.mark.heavy
@pytest.mark.parametrize("name", TAXELS)
def test_stepped_boards_send_what_touches(name: str) -> None:
    layout = example(name, "steps")
    source = load_objects(layout, names=("golf-ball",), seed=1)
    frames = [touched_frames(Contract.from_layout(layout), bus, source, 2.0, seed=0) for bus in range(len(layout.bus))]
    assert sum(map(len, frames)) > 50


def test_no_force_at_gaps() -> None:
    layout = load_layout(Path("hand"))
    source = load_objects(layout, names=("basketball",), seed=1)
    touched = np.max([source.frame(step).force_n for step in range(0, 2000, 50)], axis=0).ravel()
    assert not touched[layout.taxels.gaps].any()
    assert (np.delete(touched, layout.taxels.gaps) > 0).mean() > 0.5


def test_the_file_of_the_forearm_is_the_one_that_its_program_writes() -> None:
    assert (FOLDER / "forearm.csv").read_text() == "\n".join(forearm()) + "\n"
