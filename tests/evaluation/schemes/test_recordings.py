"""The user's own recordings: which files are shown, in which units, and verdicts on all schemes."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from canskin.messages import IMAGE
from dbc.contract import Contract
from evaluation.command import evaluate as command
from evaluation.result import Options, Row
from evaluation.schemes.comparison import DIGITS
from evaluation.schemes.recordings import evaluate
from evaluation.schemes.scenes import Touch
from evaluation.schemes.schemes import Scheme
from recording.sinks import McapSink
from skin.layout import load_layout
from tests import messages as make


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A glove in CSV, a mat in NPZ with labels beside it, a text, and a file that cannot be read."""
    frames = np.random.default_rng(3).integers(0, 200, (30, 16, 16))
    rows = "\n".join(",".join(map(str, frame.ravel())) for frame in frames)
    (tmp_path / "glove.csv").write_text(f"# shape: 16 16\n{rows}\n")
    mat = np.zeros((5, 64, 32), np.uint16)
    mat[:, 10:20, 5:9] = np.arange(1, 6)[:, None, None] * 100
    np.savez(tmp_path / "mat.npz", label=np.arange(5), mat=mat)
    (tmp_path / "notes.txt").write_text("a glove")
    (tmp_path / "broken.npy").write_bytes(b"no array")
    return tmp_path


def test_a_small_recording_fills_the_skin_with_frames_drawn_by_seed(folder: Path) -> None:
    path = str(folder / "glove.csv")
    force_n = Touch(path, seed=1, frame_ms=40).load().true_n
    assert force_n.shape == (30 * 40, 4096)
    tiles = force_n[0].reshape(4, 16, 4, 16).swapaxes(1, 2).reshape(16, 256)
    assert len(np.unique(tiles, axis=0)) > 1
    lines = np.loadtxt(path, delimiter=",")
    assert all((np.abs(tile / 0.02 * lines.max() - lines).max(axis=1) < 1e-3).any() for tile in tiles)
    assert (force_n[39] == force_n[0]).all()
    assert (force_n[40] != force_n[0]).any()
    assert (Touch(path, seed=2).load().true_n[0] != force_n[0]).any()


def test_the_full_scale_is_the_largest_value_or_the_given_one(folder: Path) -> None:
    path = str(folder / "mat.npz")
    assert Touch(path).load().true_n.max() == pytest.approx(0.02)
    assert Touch(path, full_scale=4095.0).load().true_n.max() == pytest.approx(0.02 * 500 / 4095)
    assert Touch(path, full_scale=100.0).load().true_n.max() == pytest.approx(0.02)  # a sensor ends there


def test_a_recording_of_a_skin_stays_in_newtons(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    sink = McapSink(path, Contract.from_layout(load_layout()), 0, 0)
    pixels = np.zeros((64, 64), np.float32)
    pixels[20:30, 20:30] = 0.005
    for cycle in (1, 2):
        sink.message(IMAGE, cycle, msgspec.msgpack.encode(make.image(cycle, pixels=pixels.tobytes())))
    sink.close()
    np.testing.assert_allclose(Touch(str(path)).load().true_n, np.tile(pixels.ravel(), (200, 1)))


def test_every_scheme_has_its_verdict_and_units_are_stated(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measured(scheme: Scheme, touch: Touch) -> Row:
        clocked = {"kbit_per_s": 3000.0, "rate_hz": 40.0, "psnr_mean_db": 30.0 + len(scheme.name)}
        events = {"kbit_per_s": 100.0, "rate_hz": None, "psnr_mean_db": 35.0}
        figures = dict.fromkeys(DIGITS, touch.load().true_n.max()) | {"receiver": "plain"}
        return figures | (clocked if scheme.name[0] == "s" else events)

    monkeypatch.setattr("evaluation.schemes.comparison.measure_scheme", measured)
    found = evaluate(Options(quick=True, recordings=folder, frame_rate_hz=25.0))
    shown = {"recording glove.csv", "recording mat.npz"}
    assert {row["touch"] for row in found.rows} == shown | {"all recordings"}
    assert len({row["scheme"] for row in found.rows}) == len(found.rows) / 3 >= 5
    units, *verdicts = found.note.splitlines()
    assert "20 mN are the largest value of each recording" in units
    assert "lasts 40 ms (given)" in units
    assert len(verdicts) == 2 + 2 * 3
    assert all(line.startswith(("win: ", "LOSS in ")) for line in verdicts if " against " not in line)
    assert "broken.npy" in capsys.readouterr().err


def test_folders_and_units_that_do_not_fit_are_one_clear_error(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="recordings needs recordings of a pressure mat, glove or skin"):
        command("recordings")
    with pytest.raises(InputError, match="only 'recordings' takes --rate, not 'claims'"):
        command("claims", rate=25.0)
    with pytest.raises(InputError, match=r"expected 1 to 1000 frames per second \(--rate\), got 0"):
        command("recordings", folder, rate=0.0)
    with pytest.raises(InputError, match="full scale"):
        command("recordings", folder, full_scale=0.0)
    (folder / "glove.csv").unlink()
    np.savez(folder / "mat.npz", mat=np.zeros((2, 65, 3)))
    with pytest.raises(InputError, match=r"no recording in .* can be shown: "):
        command("recordings", folder)
    for path in folder.iterdir():
        path.unlink()
    with pytest.raises(InputError, match=r"no recording in .*: expected \.npz, \.npy, \.csv, \.mcap files"):
        command("recordings", folder)
