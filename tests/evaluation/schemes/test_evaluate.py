"""The two subjects, quick: what they compare, what they recommend, and what they leave out."""

import io
from pathlib import Path

import numpy as np
import pytest

from bandwidth.alternatives import planned
from bandwidth.traffic import Disturbance
from canskin.errors import InputError
from evaluation.result import Options, Result
from evaluation.schemes.comparison import evaluate as evaluate_schemes
from evaluation.schemes.comparison_pictures import in_use
from evaluation.schemes.default_skin import default_kbit_per_s
from evaluation.schemes.rates import evaluate as evaluate_rates
from evaluation.schemes.scenes import SLAP, SLAP_MS, Touch, recordings_in
from evaluation.schemes.schemes import Sums
from evaluation.schemes.sums import SOLVED_NS
from skin.layout import parse_layout


@pytest.fixture(scope="module")
def compared() -> Result:
    return evaluate_schemes(Options(quick=True))


@pytest.mark.slow
def test_whoever_goes_by_the_clock_has_the_same_bits(compared: Result) -> None:
    clocked = [row for row in compared.rows if row["rate_hz"] is not None]
    assert {row["scheme"] for row in clocked} >= {"sums, 16 bits", "scan, 10 bits", "32 x 32, solved"}
    for row in clocked:
        # The touches are short here, and only whole scans are sent.
        assert row["kbit_per_s"] == pytest.approx(default_kbit_per_s(), rel=0.05)


@pytest.mark.slow
def test_events_take_what_touch_and_noise_make_of_them(compared: Result) -> None:
    events = {
        row["touch"]: row
        for row in compared.rows
        if row["rule"] == "one for all" and row["scheme"].startswith("events") and "solved" not in row["scheme"]
    }
    sums = {row["touch"]: row for row in compared.rows if row["scheme"] == "sums, 16 bits"}
    quiet, noisy, slap = "golf-ball", "golf-ball, noise 2 mN", "three boxes slapped on"
    assert events[quiet]["kbit_per_s"] < 0.1 * sums[quiet]["kbit_per_s"]
    assert events[noisy]["kbit_per_s"] > sums[noisy]["kbit_per_s"]
    assert events[quiet]["psnr_mean_db"] < sums[quiet]["psnr_mean_db"]  # which nodes have averaged
    assert events[slap]["latency_worst_ms"] > 2 * sums[slap]["latency_worst_ms"]
    assert sums[slap]["latency_worst_ms"] < 9


@pytest.mark.slow
def test_adaptive_sums_are_the_nearest_to_the_touch_and_every_touch_has_its_verdict(compared: Result) -> None:
    quiet = {row["scheme"]: row for row in compared.rows if row["touch"] == "golf-ball"}
    ours = quiet.pop("adaptive sums")
    unfiltered = [row for name, row in quiet.items() if not name.startswith("filtered")]
    assert ours["psnr_mean_db"] > max(row["psnr_mean_db"] for row in unfiltered)
    assert any(name.startswith("filtered events") for name in quiet)
    assert len(compared.note.splitlines()) == 1 + len({row["touch"] for row in compared.rows})


@pytest.mark.slow
def test_every_row_has_the_same_columns_and_every_picture_is_drawn(compared: Result) -> None:
    assert len({tuple(row) for row in compared.rows}) == 1
    for picture in compared.pictures:
        picture.draw().savefig(io.BytesIO())
    assert len(compared.pictures) == 3


@pytest.mark.slow
def test_recommended_layouts_are_planned_without_a_problem(tmp_path: Path) -> None:
    found = evaluate_rates(Options(quick=True, out=tmp_path))
    assert {row["wires"] for row in found.rows if row["best_for"]} == {row["wires"] for row in found.rows}
    written = sorted(tmp_path.glob("*.toml"))
    assert [path.stem for path in written] == ["four-classic-buses", "one-FD-bus", "one-classic-bus"]
    for path in written:
        layout = parse_layout(path.read_bytes(), str(path))
        row = next(row for row in found.rows if row["wires"] == path.stem.replace("-", " ") and row["best_for"])
        plans = planned(layout, Disturbance())
        assert not any(plan.problems for plan in plans)
        assert max(plan.load_worst for plan in plans) == pytest.approx(row["load_worst"], abs=6e-4)
        assert (layout.sync.rate_hz, layout.measurement.sums) == (row["rate_hz"], row["sums"])
    for picture in found.pictures:
        picture.draw().savefig(tmp_path / "surface.png")


def test_recordings_are_played_as_they_are(tmp_path: Path) -> None:
    frames = np.arange(2 * 64 * 32, dtype=np.uint16).reshape(2, 64, 32)
    np.savez(tmp_path / "S1.npz", first=frames, second=frames[::-1])
    (path,) = recordings_in(tmp_path)
    played = Touch(path).load()
    assert played.true_n.shape == (200, 4096)
    assert played.true_n is played.felt_n
    assert played.true_n[0].reshape(64, 64)[0, 1] == pytest.approx(0.02 / frames.max())
    assert played.true_n[199].max() == pytest.approx(0.02)
    with pytest.raises(InputError, match="no recording"):
        recordings_in(tmp_path.parent / "nothing")


@pytest.mark.heavy
def test_the_first_image_of_a_slap_is_that_of_the_next_sync() -> None:
    # SYNC comes 10 ms after the slap began, frames take 7 to 9 ms, and SOLVED_NS passes until the image is in use.
    solved_ms = round(SOLVED_NS * 1e-6)
    before, after = (
        in_use(Sums(16), Touch(SLAP, ticks=400), SLAP_MS + 10 + frames_ms + solved_ms).max() for frames_ms in (7, 9)
    )
    assert before < 0.002 < after
