"""The two subjects, quick: what they compare, what they recommend, and what they leave out."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bandwidth.alternatives import planned
from bandwidth.traffic import Disturbance
from evaluation.findings import Findings, Options
from evaluation.schemes import rate_notes
from evaluation.schemes.default_skin import default_kbit_per_s
from evaluation.schemes.rates import evaluate as evaluate_rates
from evaluation.schemes.rival_images import caption, first_after_slap_ms
from evaluation.schemes.rivals import evaluate as evaluate_rivals
from evaluation.schemes.scenes import recordings_in, scene
from evaluation.schemes.sums import SOLVED_NS
from evaluation.schemes.touches import Touch
from skin.errors import InputError
from skin.layout import parse_layout


@pytest.fixture(scope="module")
def rivals() -> Findings:
    return evaluate_rivals(Options(quick=True))


def test_whoever_goes_by_the_clock_has_the_same_bits(rivals: Findings) -> None:
    clocked = [row for row in rivals.rows if row["rate_hz"] is not None]
    assert {row["contender"] for row in clocked} >= {"sums, 16 bits", "scan, 10 bits", "32 x 32, solved"}
    for row in clocked:
        # The touches are short here, and only whole scans are sent.
        assert row["kbit_per_s"] == pytest.approx(default_kbit_per_s(), rel=0.05)


def test_events_take_what_touch_and_noise_make_of_them(rivals: Findings) -> None:
    events = {
        row["touch"]: row for row in rivals.rows if row["rule"] == "one for all" and "solved" not in row["contender"]
    }
    sums = {row["touch"]: row for row in rivals.rows if row["contender"] == "sums, 16 bits"}
    quiet, noisy, slap = "golf-ball", "golf-ball, noise 2 mN", "three boxes slapped on"
    assert events[quiet]["kbit_per_s"] < 0.1 * sums[quiet]["kbit_per_s"]
    assert events[noisy]["kbit_per_s"] > sums[noisy]["kbit_per_s"]
    assert events[quiet]["psnr_mean_db"] > sums[quiet]["psnr_mean_db"]
    assert events[slap]["latency_worst_ms"] > 2 * sums[slap]["latency_worst_ms"]
    assert sums[slap]["latency_worst_ms"] < 9


def test_every_row_has_the_same_columns_and_every_picture_is_drawn(rivals: Findings, tmp_path: Path) -> None:
    assert len({tuple(row) for row in rivals.rows}) == 1
    for picture in rivals.pictures:
        picture.draw().savefig(tmp_path / f"{picture.name}.png")
    assert {path.stem for path in tmp_path.iterdir()} == {"rivals-curves", "rivals-latency", "rivals-noise"}
    assert any("--recordings" in note for note in rivals.notes)


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
    played = scene(path)
    assert played.true_n.shape == (200, 4096)
    assert played.true_n is played.felt_n
    assert played.true_n[0].reshape(64, 64)[0, 1] == pytest.approx(0.02 / frames.max())
    assert played.true_n[199].max() == pytest.approx(0.02)
    with pytest.raises(InputError, match="no recording"):
        recordings_in(tmp_path.parent / "nothing")


def test_notes_are_of_what_ran(rivals: Findings) -> None:
    text = "\n".join(rivals.notes)
    assert f"{default_kbit_per_s():.0f} kbit/s" in text
    assert "Noise known" not in text  # no such receiver in a quick look
    for touch in ("golf-ball", "three boxes slapped on", "golf-ball, noise 2 mN"):
        mine = [
            row for row in rivals.rows if row["touch"] == touch and row["kbit_per_s"] <= 1.01 * default_kbit_per_s()
        ]
        most_db = max(row["psnr_mean_db"] for row in mine)
        (said,) = [note for note in rivals.notes if note.startswith(f"{touch}: best")]
        assert f"{most_db:.1f} dB" in said


def test_rate_notes_name_touches_points_and_what_cannot_be_laid_out() -> None:
    row = {"sums": 4096, "rows_of_32": 32, "bits": 8, "rate_hz": 51.0, "load": 0.7, "load_worst": 0.9}
    best = {"psnr_slides_db": 33.0, "psnr_shaking_db": 31.25}
    rows = [
        row | best | {"wires": "four classic buses", "best_for": ["slides"]},
        row | best | {"wires": "four classic buses", "bits": 16, "best_for": ["shaking"]},
        row | best | {"wires": "one classic bus", "best_for": []},
    ]
    touches = {"slides": [Touch("cup", ticks=300)], "shaking": [Touch("two boxes shaking")]}
    said = rate_notes.notes(rows, rows[:1], touches, Options(quick=True))
    assert any("300 ms at the paper's speed: cup." in note for note in said)
    assert any("up to 26 times as fast" in note for note in said)
    assert any(note.startswith("one classic bus: 32 rows of 16 bits need") for note in said)
    assert any(
        "Best on the shaking boxes: four classic buses, 4096 sums of 16 bits at 51 Hz, 31.2 dB" in note for note in said
    )
    assert not any("recordings:" in note for note in said)


@pytest.mark.parametrize("evaluated", [evaluate_rivals, evaluate_rates])
def test_draws_are_refused(evaluated: Callable[[Options], Findings]) -> None:
    with pytest.raises(InputError, match="leave out --draws"):
        evaluated(Options(quick=True, draws=2))


def test_the_first_image_of_a_slap_is_that_of_the_next_sync() -> None:
    # The slap begins at 300 ms, SYNC comes at 310, frames take 7 to 9 ms, and SOLVED_NS passes until its image is used.
    assert 10 + 7 + SOLVED_NS * 1e-6 < first_after_slap_ms() < 10 + 9 + SOLVED_NS * 1e-6
    assert f"{first_after_slap_ms():.1f} ms" in caption()
