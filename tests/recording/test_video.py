"""A video shows every image for as long as it was, with the marks of the page."""

from pathlib import Path

import av
import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from canskin.messages import CONTACTS, IMAGE
from dbc.contract import Contract
from health.state import FRESH_S
from recording.drawing import LINE, Drawing
from recording.export_command import export
from recording.sinks import McapSink
from recording.video import TICK_S
from skin.plane import Plane
from tests import messages as make
from tests.layouts import tube_layout
from tests.recording.helpers import OFFSET_NS

#: Times of the images; 40 ms are lost between the second and third, and 2 s before the last.
TIMES_S = (0.0, 0.01, 0.05, 0.06, 2.06)
PEAK_N = 0.08
#: Largest mean difference of the codec, of 255.
TOLERANCE = 4
CONTACT = make.contact(identity=7, row=4.0, column=9.0, peak_n=0.1, top=3, bottom=5, left=8, right=10)


def forces_n(number: int) -> np.ndarray:
    places = np.arange(16)
    return PEAK_N * np.exp(-((places[:, None] - 4) ** 2 + (places - 7 - number) ** 2) / 8).astype("<f4")


def valid(number: int) -> np.ndarray:
    return np.arange(16) != (5 if number == 2 else -1)


@pytest.fixture
def run(contract: Contract, out: Path) -> Path:
    sink = McapSink(out, contract, 1, OFFSET_NS)
    for number, time_s in enumerate(TIMES_S):
        stamps = {"cycle": number, "sync_counter": 1, "sampled_mono_ns": 5_000_000_000 + round(time_s * 1e9)}
        image = make.image(
            **stamps,
            pixels=forces_n(number).tobytes(),
            valid=valid(number).astype(np.uint8).tobytes(),
        )
        contacts = make.contacts(**stamps, contacts=[CONTACT] * (number == 1))
        sink.message(IMAGE, number, msgspec.msgpack.encode(image))
        sink.message(CONTACTS, number, msgspec.msgpack.encode(contacts))
    sink.close()
    return out


def read_back(path: Path) -> tuple[list[float], list[np.ndarray]]:
    with av.open(path) as video:
        frames = list(video.decode(video=0))
    times_s = [float(each.pts * each.time_base) for each in frames]
    return times_s, [each.to_ndarray(format="rgb24") for each in frames]


def test_times_and_pixels(run: Path, contract: Contract) -> None:
    export(run, to="video")
    times_s, pictures = read_back(run.with_suffix(".mp4"))
    shown_s = [*TIMES_S[:4], TIMES_S[3] + FRESH_S, TIMES_S[4]]
    np.testing.assert_allclose(times_s, shown_s, atol=float(TICK_S))
    drawing = Drawing(contract.layout, max(forces_n(number).max() for number in range(5)))
    for picture, number in zip(pictures[:4] + pictures[5:], range(5), strict=True):
        contacts = [CONTACT] * (number == 1)
        wanted = drawing.draw(forces_n(number), valid(number), contacts, "")[:-LINE].astype(int)
        assert np.abs(picture[:-LINE] - wanted).mean() < TOLERANCE
    old = pictures[4][:-LINE].astype(int)
    assert old.max() < 128
    assert np.ptp(old, axis=2).mean() < TOLERANCE  # grey
    with av.open(run.with_suffix(".mp4")) as video:
        assert float(video.duration / av.time_base) == pytest.approx(TIMES_S[-1] + 0.01, abs=0.002)


def test_marks(contract: Contract) -> None:
    drawing = Drawing(contract.layout, PEAK_N)
    plain = drawing.draw(forces_n(2), valid(0), [], "")
    hatched = (drawing.draw(forces_n(2), valid(2), [], "") != plain).any(axis=2)[:-LINE]
    cells = hatched.reshape(16, drawing.cell, 16, drawing.cell).all(axis=(1, 3))
    np.testing.assert_array_equal(cells.ravel(), contract.phi.block_of_taxel == 5)
    marked = drawing.draw(forces_n(2), valid(0), [CONTACT], "")
    y, x = round(4.5 * drawing.cell), round(9.5 * drawing.cell)
    assert marked[y, x].tolist() == [255, 255, 255]
    changed = np.argwhere((marked != plain).any(axis=2))
    assert np.abs(changed - (y, x)).max() < 4 * drawing.cell


def test_a_skin_that_is_no_grid_is_drawn_in_its_places() -> None:
    layout = tube_layout()
    plane, drawing = Plane(layout.taxels.surface), Drawing(layout, 1.0)
    assert (drawing.height % 2, drawing.width % 2) == (0, 0)
    forces_n, is_valid = np.zeros((1, 96), np.float32), np.arange(3) != 1
    forces_n[0, 30] = 1.0
    x, y = np.floor(plane.places * drawing.cell).astype(int).T
    plain = drawing.draw(forces_n, np.ones(3, np.bool_), [], "")
    assert np.flatnonzero((plain[y, x] != plain[y[0], x[0]]).any(axis=1)).tolist() == [30]
    hatched = (drawing.draw(forces_n, is_valid, [], "") != plain).any(axis=2)
    np.testing.assert_array_equal(hatched[y, x], layout.phi().block_of_taxel == 1)
    place, normal = layout.taxels.surface.positions_m[17].tolist(), layout.taxels.surface.normals[17].tolist()
    touch = make.contact(identity=7, row=0.0, column=17.0, position_m=place, normal=normal)
    marked = drawing.draw(forces_n, np.ones(3, np.bool_), [touch], "")
    assert np.abs(np.argwhere((marked != plain).any(axis=2)) - (y[17], x[17])).max() < 4 * drawing.cell


def test_a_video_is_an_mp4(run: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"writes no '\.avi'"):
        export(run, to="video", out=tmp_path / "run.avi")
