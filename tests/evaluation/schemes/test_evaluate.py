"""The rivals, quick: what is compared, and how verdicts read."""

import pytest

from canskin.errors import InputError
from evaluation.command import rivals
from evaluation.result import Options, Result, Row
from evaluation.schemes.comparison import DIGITS, means_of
from evaluation.schemes.comparison import evaluate as evaluate_schemes
from evaluation.schemes.scenes import SLAP, SLIDES
from evaluation.schemes.schemes import BEST_SCAN, COARSE_ARRAY, RAW_SCAN, default_kbit_per_s

CLOCKED = (BEST_SCAN.name, RAW_SCAN.name, COARSE_ARRAY.name)


@pytest.fixture(scope="module")
def compared() -> Result:
    return evaluate_schemes(Options(quick=True))


@pytest.mark.slow
def test_whoever_goes_by_the_clock_has_the_same_bits(compared: Result) -> None:
    clocked = [row for row in compared.rows if row["rate_hz"] is not None]
    assert {row["scheme"] for row in clocked} == {"sums", *CLOCKED}
    for row in clocked:
        # Only whole scans are sent, and the shortest touch lasts 0.4 s.
        assert row["kbit_per_s"] == pytest.approx(default_kbit_per_s(), rel=0.02 + 1 / (0.4 * row["rate_hz"]))


@pytest.mark.slow
def test_events_and_stepped_sums_take_few_bits_and_events_wait_where_much_moves(compared: Result) -> None:
    quiet = {row["scheme"]: row for row in compared.rows if row["touch"] == "golf-ball"}
    ours, events = quiet["steps"], quiet["filtered events, 0.5 mN"]
    assert max(ours["kbit_per_s"], events["kbit_per_s"]) < 0.2 * quiet["sums"]["kbit_per_s"]
    assert ours["psnr_mean_db"] > quiet["sums"]["psnr_mean_db"]
    assert min(ours["psnr_mean_db"], events["psnr_mean_db"]) > quiet[RAW_SCAN.name]["psnr_mean_db"]
    slap = {row["scheme"]: row for row in compared.rows if row["touch"] == SLAP}
    assert slap["filtered events, 0.5 mN"]["latency_p99_ms"] > 2 * slap["sums"]["latency_p99_ms"]
    assert slap["sums"]["latency_p99_ms"] < 9


@pytest.mark.slow
def test_a_filter_is_worth_more_than_sums_and_scans_get_the_best_receiver(compared: Result) -> None:
    """On the press of a golf ball: both at the same bits."""
    rows = {row["scheme"]: row for row in compared.rows if row["touch"] == "golf-ball"}
    raw, best = rows[RAW_SCAN.name], rows[BEST_SCAN.name]
    assert raw["receiver"] != "plain"
    assert best["psnr_mean_db"] > raw["psnr_mean_db"] + 20
    assert best["psnr_mean_db"] == pytest.approx(rows["sums"]["psnr_mean_db"], abs=4)


@pytest.mark.slow
def test_drawn_scenes_have_a_row_for_each_scheme_and_their_mean() -> None:
    found = evaluate_schemes(Options(quick=True, scene_seed=3))
    assert len({row["touch"] for row in found.rows}) == 3
    for row in found.rows:
        assert (row["psnr_spread_db"] is None) == (row["touch"] != "all scenes")


def test_no_drawn_scene_is_refused() -> None:
    with pytest.raises(InputError, match="expected 1 drawn scene or more"):
        rivals(scenes=0, scene_seed=3)


def test_slides_have_a_row_of_means() -> None:
    def row(touch: str, scheme: str, psnr_db: float, error_mn: float, kbit_per_s: float) -> Row:
        figures = {"psnr_mean_db": psnr_db, "touched_error_mn": error_mn, "kbit_per_s": kbit_per_s}
        return (
            dict.fromkeys(DIGITS, 1.0)
            | {"rate_hz": None if scheme in {"steps", "events"} else 40, "touch": touch, "scheme": scheme}
            | {"receiver": "plain"}
            | figures
        )

    rows = [row(name, "scan", 40 + place, 0.8, 3000) for place, name in enumerate(SLIDES)]
    (together,) = means_of(rows, SLIDES, "five slides")
    assert (together["touch"], together["scheme"], together["psnr_mean_db"]) == ("five slides", "scan", 42)
    assert together["rate_hz"] == 40
    assert (together["psnr_spread_db"], together["receiver"]) == (1.4, "plain")
    assert not means_of(rows[:4], SLIDES, "five slides")
