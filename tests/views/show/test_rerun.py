"""What Rerun's own reader finds in the files made for Rerun."""

import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import rerun_bindings
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from canskin.errors import RunError
from canskin.fabric import Fabric
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL
from recording.export_command import export
from shell.service import StopSignal
from skin.wall_times import CLOCKS, Clocks
from tests import messages as make
from tests.health.helpers import Messages
from tests.layouts import tube_layout
from tests.processes import free_port
from tests.recording.helpers import COUNT, OFFSET_NS, SET_NS, pixels
from views.show import rerun_canvas
from views.show.command import draw_live
from views.show.rerun_canvas import RerunCanvas


def rows_of(path: Path, entity: str) -> list[dict[str, Any]]:
    """Return the rows of an entity that have a time, in its order."""
    rows = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == f"/{entity}" and not chunk.is_static:
            batch = chunk.to_record_batch()
            times_ns = batch.column("sampled").cast("int64").to_pylist()
            columns = {name: batch.column(name).to_pylist() for name in batch.schema.names if name != "sampled"}
            rows += [
                {"sampled": time_ns, **{name: values[place] for name, values in columns.items()}}
                for place, time_ns in enumerate(times_ns)
            ]
    return sorted(rows, key=lambda row: row["sampled"])


def force_n(row: dict[str, Any]) -> np.ndarray:
    (tensor,) = row["Tensor:data"]
    return np.array(tensor["buffer"], np.float32).reshape(tensor["shape"])


def test_recording_becomes_a_file_with_every_image_bit_for_bit(run: Path) -> None:
    export(run, to="rerun")
    rows = rows_of(run.with_suffix(".rrd"), "skin/image")
    assert [row["sampled"] for row in rows] == [
        OFFSET_NS + 10 * cycle + SET_NS * (cycle > 2) for cycle in range(1, COUNT + 1)
    ]
    assert [row["cycle"] for row in rows] == [1, 2, 3, 4]
    assert np.isnan(force_n(rows[0])).all()
    for cycle, row in enumerate(rows[1:], 2):
        assert force_n(row).tobytes() == pixels(cycle).tobytes()


@pytest.mark.heavy
def test_rerun_verifies_the_file(run: Path, tmp_path: Path) -> None:
    export(run, to="rerun", out=tmp_path / "run.rrd")
    command = [sys.executable, "-m", "rerun", "rrd", "verify", str(tmp_path / "run.rrd")]
    verified = subprocess.run(command, capture_output=True, text=True, check=False, env={"RERUN_ANALYTICS": "0"})
    assert verified.returncode == 0, verified.stderr
    assert "verified without error" in verified.stdout + verified.stderr


def test_taxels_lie_in_their_places(run: Path) -> None:
    export(run, to="rerun")
    static = [
        chunk.to_record_batch().to_pylist()[0]
        for chunk in RrdReader(run.with_suffix(".rrd")).stream()
        if chunk.entity_path == "/skin/space/taxels" and chunk.is_static
    ]
    places = np.array(next(row["Boxes3D:centers"] for row in static if "Boxes3D:centers" in row))
    assert places.shape == (256, 3)
    assert places[0].tolist() == pytest.approx([-0.03, -0.03, 0.0])
    assert places[17].tolist() == pytest.approx([-0.026, -0.026, 0.0])
    colours = rows_of(run.with_suffix(".rrd"), "skin/space/taxels")
    assert {len(row["Boxes3D:colors"]) for row in colours} == {256}
    assert set(colours[0]["Boxes3D:colors"]) == {0x808080FF}  # nothing is valid in the first image
    picture = rows_of(run.with_suffix(".rrd"), "skin/heat_map")[0]
    assert set(picture["Image:buffer"][0]) == {0x80}


def test_a_skin_that_is_no_grid_is_discs_along_its_normals(tmp_path: Path) -> None:
    layout = tube_layout()
    surface, canvas = layout.taxels.surface, RerunCanvas(layout, tmp_path / "it.rrd")
    forces_n = np.linspace(0, 0.02, 96, dtype=np.float32)[None]
    contact = make.contact(row=0.0, column=17.0, position_m=(0.0, 0.02, 0.01), normal=(0.0, 1.0, 0.0))
    canvas.image(1, 1, forces_n)
    canvas.contacts(1, 1, [contact])
    canvas.close()
    static = [
        chunk.to_record_batch().to_pylist()[0]
        for chunk in RrdReader(tmp_path / "it.rrd").stream()
        if chunk.entity_path == "/skin/space/taxels" and chunk.is_static
    ]
    discs = next(row for row in static if "Ellipsoids3D:centers" in row)
    np.testing.assert_allclose(discs["Ellipsoids3D:centers"], surface.positions_m, atol=1e-8)
    turned = Rotation.from_quat(discs["Ellipsoids3D:quaternions"]).apply((0, 0, 1))
    np.testing.assert_allclose(turned, surface.normals, atol=1e-6)
    (row,) = rows_of(tmp_path / "it.rrd", "skin/space/taxels")
    assert len(set(row["Ellipsoids3D:colors"])) > 80
    assert not rows_of(tmp_path / "it.rrd", "skin/heat_map")
    np.testing.assert_array_equal(force_n(rows_of(tmp_path / "it.rrd", "skin/image")[0]), forces_n)
    (arrow,) = rows_of(tmp_path / "it.rrd", "skin/space/arrows")
    tip = np.add(arrow["Arrows3D:origins"], arrow["Arrows3D:vectors"])
    np.testing.assert_allclose(tip, [contact.position_m], atol=1e-8)
    assert arrow["Arrows3D:vectors"][0][1] < 0  # a touch presses against the normal


def test_a_live_skin_is_drawn_with_contacts_curves_and_log(
    hub: Fabric, endpoint: str, messages: Messages, tmp_path: Path
) -> None:
    path, stop = tmp_path / "live.rrd", StopSignal()
    canvas, fabric = RerunCanvas(messages.layout, path), Fabric("palm", "show", endpoint)
    painters: list[Any] = []
    drawing = threading.Thread(target=lambda: painters.append(draw_live(messages.layout, fabric, canvas, stop)))
    drawing.start()
    # Topics are subscribed one after the other: a message of the last may come where one before did not.
    came = {name: threading.Event() for name in ("contacts", "label_confidence", "load/left", "valid_share")}
    count, contacts, figure = 0, canvas.contacts, canvas.figure
    canvas.contacts = lambda *given: (contacts(*given), came["contacts"].set())  # type: ignore[assignment,func-returns-value]
    canvas.figure = lambda *given: (figure(*given), given[1] in came and came[given[1]].set())  # type: ignore[assignment,func-returns-value]
    while not all(event.wait(0.05) for event in came.values()):
        count += 1
        for topic, message in (
            (CLOCKS, Clocks(sampled_mono_ns=0, wall_offset_ns=OFFSET_NS)),
            (IMAGE, messages.image(count)),
            (LABEL, messages.label("ring")),
            (GATEWAY, messages.gateway()),
            (CONTACTS, messages.contacts(count)),
        ):
            hub.publish(topic, message)
    stop.set()
    drawing.join()
    canvas.close()
    fabric.close()
    assert rows_of(path, "skin/space/contacts")[0]["Ellipsoids3D:labels"] == ["7: 376.6 mN"]
    assert rows_of(path, "skin/figures/load/left")[0]["Scalars:scalars"] == [0.8]
    assert rows_of(path, "skin/figures/valid_share")[0]["Scalars:scalars"] == [1.0]
    assert rows_of(path, "skin/figures/label_confidence")[0]["Scalars:scalars"] == [0.93]
    assert ["touched by: ring"] in [row["TextLog:text"] for row in rows_of(path, "skin/log")]


def test_doubtful_contacts_have_another_colour_and_a_question_mark(messages: Messages, tmp_path: Path) -> None:
    canvas, contact = RerunCanvas(messages.layout, tmp_path / "it.rrd"), messages.contacts().contacts[0]
    canvas.contacts(1, 1, [contact, msgspec.structs.replace(contact, doubtful_since_mono_ns=5)])
    canvas.close()
    (row,) = rows_of(tmp_path / "it.rrd", "skin/space/contacts")
    assert row["Ellipsoids3D:labels"] == ["7: 376.6 mN", "7: 376.6 mN?"]
    assert len(set(row["Ellipsoids3D:colors"])) == 2


@pytest.mark.heavy
def test_a_viewer_that_is_started_listens_on_loopback_alone(
    messages: Messages, monkeypatch: pytest.MonkeyPatch
) -> None:
    start, started, port = rerun_bindings.spawn, list[int](), free_port()

    def start_without_window(*, extra_args: list[str], **options: Any) -> None:
        started.append(start(extra_args=[*extra_args, "--serve-grpc"], **options) or 0)

    monkeypatch.setattr(rerun_canvas, "PORT", port)
    monkeypatch.setattr(rerun_bindings, "spawn", start_without_window)
    canvas = RerunCanvas(messages.layout)
    try:
        with pytest.raises(ConnectionRefusedError):  # a server on all networks would be on all addresses of loopback
            socket.create_connection(("127.0.0.2", port))
        canvas.close()
    finally:
        os.kill(started[0], signal.SIGTERM)


@pytest.mark.heavy
def test_a_viewer_that_does_not_answer_is_an_error(messages: Messages) -> None:
    with pytest.raises(RunError, match="unable to connect"):
        RerunCanvas(messages.layout, "rerun+http://127.0.0.1:1/proxy")


def test_a_viewer_that_has_gone_is_an_error_at_the_end(
    messages: Messages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone() -> None:
        raise RuntimeError("gRPC has been unable to connect")

    canvas = RerunCanvas(messages.layout, tmp_path / "run.rrd")
    monkeypatch.setattr(canvas._stream, "flush", gone)
    with pytest.raises(RunError, match="unable to connect"):
        canvas.close()
