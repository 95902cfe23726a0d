"""The analogue front end: gains of two paths, offset, noise and skew of sums, and the converter."""

from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError, LayoutError
from skin.defects import Defects, parse_defects
from skin.frontend import SumModel, converter
from skin.layout import Layout, load_layout, parse_layout
from skin.phi import fast_hadamard

LAYOUT = load_layout(Path("analogue"))
PHI = LAYOUT.phi()
SUMS = PHI.shape[0]
FORCE_N = np.random.default_rng(3).uniform(0, 0.02, 4096).astype(np.float32)


def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def model(seed: int = 0, **amounts: float) -> SumModel:
    return SumModel(PHI, Defects.of(amounts, seed))


def with_taxels(keys: str, rest: str = "") -> Layout:
    return parse_layout(f'[taxels]\nrows = 16\ncolumns = 16\nfrontend = "analogue"\n{keys}\n{rest}'.encode(), "test")


def test_a_perfect_front_end_gives_the_sums_of_phi_and_clips_no_taxel() -> None:
    beyond = 3 * FORCE_N - 0.01
    np.testing.assert_array_equal(model().sums_n(beyond, rng()), PHI.forward(beyond))


def test_gains_of_two_paths_weigh_the_taxels_that_are_added_and_subtracted() -> None:
    mismatched = model(4, mismatch=0.05)
    gains = mismatched.gains
    assert gains is not None
    plus, minus = gains.differential + gains.common_mode, gains.differential - gains.common_mode
    assert (plus.std(), minus.std()) == pytest.approx((0.05, 0.05), rel=0.1)
    signs = np.asarray(fast_hadamard(np.eye(32)))[PHI.row_of_sum]
    chains = FORCE_N[PHI.taxels_of_blocks[PHI.block_of_sum]]
    expected = plus * (chains * (signs > 0)).sum(axis=1) - minus * (chains * (signs < 0)).sum(axis=1)
    found = mismatched.sums_n(FORCE_N, rng())
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_offset_and_noise_of_sums() -> None:
    still = np.zeros((200, 4096), np.float32)
    made = model(2, sum_offset=0.01, sum_noise=0.001).sums_n(still, rng())
    assert made.mean(axis=0).std() == pytest.approx(0.01, rel=0.1)
    assert made.std(axis=0).mean() == pytest.approx(0.001, rel=0.02)


def test_rows_are_read_one_after_the_other_while_the_touch_moves() -> None:
    change = np.random.default_rng(5).normal(0, 0.1, 4096).astype(np.float32)
    made = model(skew=1e-3).sums_n(FORCE_N, rng(), change_n_per_s=change)
    place = np.arange(SUMS) - PHI.starts[PHI.block_of_sum]
    for late in (0, 5):
        exact = PHI.forward(FORCE_N + np.float32(late * 1e-3) * change)
        np.testing.assert_allclose(made[place == late], exact[place == late], atol=1e-6)


def test_a_converter_spans_half_the_block_and_its_end_codes_are_saturated() -> None:
    of_sums = converter(LAYOUT)
    assert of_sums is not None
    half_n = 16 * LAYOUT.taxels.force_max_n
    counts = of_sums.counts(np.array([0.0, 0.99 * half_n, -0.99 * half_n, 1.01 * half_n, -1.01 * half_n]))
    assert of_sums.is_saturated(counts).tolist() == [False, False, False, True, True]
    step_n = 32 * LAYOUT.taxels.newton_per_count
    sums_n = np.linspace(-0.3, 0.3, 1000)
    assert np.abs(of_sums.counts(sums_n) * LAYOUT.taxels.newton_per_count - sums_n).max() <= 0.51 * step_n
    assert converter(load_layout()) is None


def test_defects_of_sums_need_an_analogue_front_end() -> None:
    texts = ["mismatch=0.02", "dead", "skew"]
    assert [each.kind for each in parse_defects(texts, [], 7, LAYOUT).of_kinds] == ["mismatch", "dead", "skew"]
    with pytest.raises(InputError, match=r'mismatch=0.02: .* taxels.frontend = "analogue"'):
        parse_defects(texts, [], 7, load_layout())


@pytest.mark.parametrize(
    ("keys", "rest", "says"),
    [
        ("", "[sampling]\nrate_hz = 200", r"no taxels to average.* got 200 - at `\$.sampling.rate_hz`"),
        ("adc_bits = 3", "", r"expects 4 or more, got 3 - at `\$.taxels.adc_bits`"),
    ],
)
def test_keys_that_do_not_fit_an_analogue_front_end(keys: str, rest: str, says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        with_taxels(keys, rest)


def test_stepped_boards_have_digital_taxels() -> None:
    text = b'sending = "steps"\n[taxels]\nfrontend = "analogue"\n[measurement]\nwiring = "board"\n'
    with pytest.raises(LayoutError, match=r"expects 'digital', got 'analogue'"):
        parse_layout(text, "test")
