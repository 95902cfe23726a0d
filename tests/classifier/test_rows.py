"""Which rows tell objects apart."""

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from classifier.rows import choose_rows, with_chosen_rows
from skin.phi import sbhe
from tests.layouts import small_layout

PHI = sbhe(64, 64, block_size=8)
LABELS = np.repeat(["a", "b", "c"], 50)


def observed(informative: dict[int, tuple[float, float, float]], seed: int = 0) -> np.ndarray:
    sums = np.random.default_rng(seed).normal(size=(150, 64))
    for row, means in informative.items():
        sums[:, row] += np.repeat(means, 50)
    return sums


def test_rows_that_differ_are_found() -> None:
    chosen = choose_rows(PHI, observed({5: (0, 9, 0), 40: (0, 0, 9)}), LABELS, 2)
    assert chosen.shape == (2, 64)
    np.testing.assert_array_equal(np.flatnonzero(chosen.kept), [5, 40])
    np.testing.assert_array_equal(chosen.order, PHI.order)


def test_a_row_that_repeats_another_is_not_sent() -> None:
    sums = observed({5: (0, 9, 0), 40: (0, 0, 4)})
    sums[:, 6] = sums[:, 5] + 1e-6 * sums[:, 7]
    kept = np.flatnonzero(choose_rows(PHI, sums, LABELS, 2).kept)
    assert len({5, 6} & set(kept)) == 1
    assert 40 in kept


@pytest.mark.parametrize(
    ("sums", "labels", "count", "says"),
    [
        (np.zeros((150, 63)), LABELS, 2, "expected sums of shape"),
        (np.zeros((150, 64)), LABELS, 65, "1 to 64 rows"),
        (np.zeros((150, 64)), LABELS, 0, "1 to 64 rows"),
        (np.zeros((150, 64)), np.zeros(150), 2, "2 or more labels"),
        (np.zeros((3, 64)), np.array([0, 0, 1]), 2, "2 or more labels"),
    ],
)
def test_what_cannot_be_used(sums: np.ndarray, labels: np.ndarray, count: int, says: str) -> None:
    with pytest.raises(InputError, match=says):
        choose_rows(PHI, sums, labels, count)


def test_layout_that_names_the_chosen_rows() -> None:
    layout = small_layout(16, 16, sync={"rate_hz": 20.0})
    force_n = np.zeros((40, 16, 16), np.float32)
    force_n[:20, :8], force_n[20:, 8:] = 0.01, 0.01
    labels = np.repeat(["top", "bottom"], 20)
    chosen = with_chosen_rows(layout, force_n, labels, 3, noise_n=1e-3)
    assert (chosen.measurement.sums, len(chosen.measurement.rows or ())) == (3, 3)
    phi = chosen.phi()
    assert (phi.order == layout.phi().order).all()
    sums = phi.forward(force_n.reshape(40, -1))
    assert (np.abs(sums[0] - sums[-1]) > 0.05).all()
    with pytest.raises(InputError, match="stepped nodes"):
        with_chosen_rows(msgspec.structs.replace(layout, sending="steps"), force_n, labels, 3, noise_n=1e-3)
