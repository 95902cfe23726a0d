import math
from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError
from skin.defects import KINDS, Defect, Defects, Stage, option_name, parse_defects
from skin.layout import Taxels, load_layout
from skin.taxel import TaxelModel, sense, to_counts, to_newtons

QUIET = TaxelModel(noise_n=0.0)
LAYOUT, ANALOGUE = load_layout(), load_layout(Path("analogue"))
PERIOD_S = 1e-3
DOCUMENT = Path(__file__).parents[2] / "docs" / "data.md"


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def worn(seed: int = 0, **amounts: float) -> TaxelModel:
    return TaxelModel(noise_n=0.0, defects=Defects.of(amounts, seed))


def test_noise_has_the_stated_deviation_and_values_stay_in_range() -> None:
    signal = sense(np.full((400, 500), 0.01, np.float32), rng())
    assert signal.dtype == np.float32
    assert signal.mean() == pytest.approx(0.01, abs=1e-5)
    assert signal.std() == pytest.approx(1e-3, rel=0.01)
    assert sense(np.full(9, 0.5, np.float32), rng()).tolist() == [np.float32(0.02)] * 9


def test_clipping_halves_the_error_of_an_untouched_taxel() -> None:
    """Mean square sigma^2 / 2: the 29.03 dB of a skin that nothing touches."""
    signal = sense(np.zeros((300, 64, 64), np.float32), rng()).astype(np.float64)
    assert 10 * np.log10(0.02**2 / (signal**2).mean()) == pytest.approx(29.03, abs=0.02)


def test_without_defects_a_taxel_only_senses() -> None:
    force_n = np.full((3, 4, 4), 0.004, np.float32)
    np.testing.assert_array_equal(TaxelModel().signal(force_n, rng(), period_s=PERIOD_S), sense(force_n, rng()))


def test_a_damper_adds_the_speed_of_compression() -> None:
    ramp = np.array([0.0, 0.001, 0.003, 0.003, 0.0], np.float32).reshape(5, 1, 1)
    felt = worn(damper=0.001).signal(ramp, rng(), period_s=PERIOD_S)
    np.testing.assert_allclose(felt.ravel(), [0.0, 0.002, 0.005, 0.003, 0.0], atol=1e-9)


def test_cross_talk_reaches_the_four_neighbours() -> None:
    force_n = np.zeros((1, 3, 4), np.float32)
    force_n[0, 1, 0] = 0.01
    felt = worn(cross_talk=0.1).signal(force_n, rng(), period_s=PERIOD_S)
    expected = [[0.001, 0, 0, 0], [0.01, 0.001, 0, 0], [0.001, 0, 0, 0]]
    np.testing.assert_allclose(felt[0], expected, atol=1e-9)


def test_gains_belong_to_the_taxels_and_not_to_the_run() -> None:
    force_n = np.full((2, 64, 64), 0.005, np.float32)
    felt = worn(2, gain_spread=0.1).signal(force_n, rng(), period_s=PERIOD_S)
    np.testing.assert_array_equal(felt[0], felt[1])
    assert (felt / 0.005).std() == pytest.approx(0.1, rel=0.05)


def test_drift_grows_with_time() -> None:
    model = worn(1, drift=0.001)
    offsets = model.felt_n(np.zeros((3, 8, 8), np.float32), np.array([0.0, 1.0, 3.0]))
    assert not offsets[0].any()
    np.testing.assert_allclose(offsets[2], 3 * offsets[1], rtol=1e-6)
    late = model.signal(np.full((1, 8, 8), 0.01, np.float32), rng(), period_s=PERIOD_S, start_s=1.0)
    np.testing.assert_allclose(late[0], 0.01 + offsets[1], atol=1e-8)


def test_stuck_taxels_keep_a_value_and_dead_ones_read_zero() -> None:
    force_n = np.stack([np.full((10, 10), value, np.float32) for value in (0.002, 0.008)])
    stuck = worn(stuck=0.07).signal(force_n, rng(), period_s=PERIOD_S)
    assert (stuck[0] == stuck[1]).sum() == 7
    dead = worn(dead=0.001).signal(force_n, rng(), period_s=PERIOD_S)
    assert [(frame == 0).sum() for frame in dead] == [1, 1]
    none = TaxelModel(noise_n=0.0, defects=Defects((Defect("dead", 0.0), Defect("stuck", 0.0)))).signal(
        force_n, rng(), period_s=PERIOD_S
    )
    np.testing.assert_array_equal(none, force_n)


def test_saturated_taxels_read_the_end_of_the_range_and_noisy_ones_a_quarter_of_it_as_noise() -> None:
    force_n = np.full((2000, 10, 10), 0.01, np.float32)
    full = worn(saturated=0.03).signal(force_n[:2], rng(), period_s=PERIOD_S)
    assert [(frame == np.float32(0.02)).sum() for frame in full] == [3, 3]
    noisy = TaxelModel(1e-4, 0.1, Defects.of({"noisy": 0.02}))
    deviations = np.sort(noisy.signal(force_n + np.float32(0.04), rng(), period_s=PERIOD_S).std(axis=0), axis=None)
    np.testing.assert_allclose(deviations[:98], 1e-4, rtol=0.1)
    assert (deviations[98:] > 0.02).all()


def test_defects_of_one_seed_meet_other_taxels() -> None:
    taxels = (64, 64)
    (dead, _), (full, _), (other, _) = (
        Defects.of({kind: 0.1}, seed).effects(Stage.READING, taxels)[0]
        for kind, seed in (("dead", 3), ("saturated", 3), ("dead", 4))
    )
    assert 0 < np.intersect1d(dead, full).size < 0.3 * dead.size
    assert not np.array_equal(dead, other)


def test_defects_are_named_with_or_without_an_amount() -> None:
    assert parse_defects(["dead", "cross-talk=0.05", "drift=2e-3"], [], 7, LAYOUT) == Defects(
        (Defect("dead", 0.01, 7), Defect("cross_talk", 0.05, 7), Defect("drift", 2e-3, 7))
    )
    every = parse_defects(KINDS, [], 1, ANALOGUE)
    assert [each.kind for each in every.of_kinds] == list(KINDS)
    assert np.isfinite(TaxelModel(defects=every).signal(np.zeros((2, 64, 64), np.float32), rng(), period_s=1.0)).all()


def test_the_document_lists_every_kind_and_its_default() -> None:
    helps = {name: f"{kind.help[0].lower()}{kind.help[1:].removesuffix('.')}" for name, kind in KINDS.items()}
    rows = {f"| `{option_name(name)}` | {helps[name]} | {kind.default:g} |" for name, kind in KINDS.items()}
    assert rows <= set(DOCUMENT.read_text(encoding="utf-8").splitlines())


@pytest.mark.parametrize(("kind", "moves"), [("offset", True), ("drift", True), ("sum_offset", True), ("dead", False)])
def test_some_kinds_move_the_zero_of_an_untouched_skin(kind: str, moves: bool) -> None:
    assert Defects.of({kind: 0.1}).moves_zero == moves


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("broken", "--defect broken: expected KIND or KIND=AMOUNT with KIND of damper, creep, cross-talk, gain-spread"),
        ("dead=", "--defect dead=: expected a number after '='"),
        ("dead=many", "expected a number after '=', got 'many'"),
        ("dead=2", "--defect dead: ratio needs a number from 0 to 1: got 2.0"),
        ("drift=nan", "--defect drift: deviation_n_per_s needs a number of 0 or more"),
    ],
)
def test_a_wrong_defect_is_refused_in_one_line(text: str, says: str) -> None:
    with pytest.raises(InputError) as refused:
        parse_defects([text], [], 0, LAYOUT)
    assert says in str(refused.value)


def test_counts_are_the_nearest_within_the_range() -> None:
    taxels = Taxels(adc_bits=12)
    force_n = np.array([-0.001, 0.0, 0.4, 0.6, 4094.4, 4095.0, 5000.0], np.float32)
    force_n[1:] *= np.float32(taxels.newton_per_count)
    assert to_counts(force_n, taxels).tolist() == [0, 0, 0, 1, 4094, 4095, 4095]
    counts = np.arange(4096)
    np.testing.assert_array_equal(to_counts(to_newtons(counts, taxels), taxels), counts)


def test_wrong_numbers_are_refused() -> None:
    for name, kind in KINDS.items():
        for value in (-0.1, 1.1, float("nan")) if kind.most == 1 else (-0.1, float("inf")):
            with pytest.raises(
                InputError, match=f"number from 0 to {kind.most:g}" if kind.most < math.inf else "0 or more"
            ):
                Defect(name, value)
    with pytest.raises(InputError, match="noise_n"):
        sense(np.zeros(3), rng(), noise_n=-1.0)
    with pytest.raises(InputError, match="force_max_n"):
        sense(np.zeros(3), rng(), force_max_n=0.0)
    with pytest.raises(InputError, match="steps, rows, columns"):
        QUIET.signal(np.zeros((3, 3), np.float32), rng(), period_s=PERIOD_S)
    with pytest.raises(InputError, match="period_s"):
        QUIET.signal(np.zeros((1, 3, 3), np.float32), rng(), period_s=0.0)


def test_offsets_stay_and_are_added_to_the_force() -> None:
    force_n = np.full((2, 64, 64), 0.005, np.float32)
    felt = worn(2, offset=0.13).signal(force_n, rng(), period_s=PERIOD_S)
    np.testing.assert_array_equal(felt[0], felt[1])
    offsets = felt[0] - 0.005
    assert offsets.min() == pytest.approx(0, abs=2e-6)
    assert offsets.max() == pytest.approx(0.13 * 0.02, rel=0.01)
    assert offsets.mean() == pytest.approx(0.065 * 0.02, rel=0.03)
