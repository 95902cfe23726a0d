"""What nodes of rows and a mixing node would send."""

import numpy as np
import pytest

from evaluation.paper import noiselets
from evaluation.paper.noiselets import KEPT, SBHE, phi_of, signed_bits, traffic
from evaluation.result import Options
from evaluation.solvers.noiselet import fast_noiselet


def test_every_sum_of_ten_bit_taxels_fits() -> None:
    for taxels, bits in ((32, 16), (64, 17), (4096, 23)):
        assert -(1 << bits - 1) <= -1023 * taxels < -(1 << bits - 2)
        assert signed_bits(taxels) == bits


def test_rows_send_more_than_a_scan_however_few_products_are_kept() -> None:
    drawn = traffic("noiselets, products drawn", 0)
    assert (drawn["frames"], drawn["mixed_frames"]) == (64 * 17, 368)  # 64 values of 17 bits; 1024 of 23
    assert drawn["frames"] > 64 * 64 * 10 / 64  # frames of a scan of 10 bits
    assert drawn["ms"] > 5 * traffic(SBHE, 0)["ms"]
    assert traffic("noiselets, 64 x 16", 0)["mixed_frames"] is None


def test_a_value_of_a_row_is_in_all_products_of_its_column() -> None:
    phi = phi_of("noiselets, products drawn", 0)
    row, column = 5, 41
    taxels = np.zeros((64, 64), np.int64)
    taxels[row] = fast_noiselet(np.eye(64, dtype=np.int64)[column])  # of this row, value 41 alone is not 0
    assert np.array_equal(phi.forward(taxels.ravel()) != 0, phi.kept % 64 == column)
    assert traffic("noiselets, products drawn", 0)["lost"] > np.count_nonzero(phi.kept % 64 == column)
    assert traffic(SBHE, 0)["lost"] == 4


@pytest.mark.parametrize("kind", KEPT)
def test_every_kind_keeps_1024_products(kind: str) -> None:
    phi = phi_of(kind, 0)
    assert phi.shape == (1024, 4096)
    assert len(np.unique(phi.kept)) == 1024


@pytest.mark.slow
def test_products_of_whole_rows_and_columns_give_worse_images(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(noiselets, "OBJECTS", ("drill",))
    monkeypatch.setitem(noiselets.QUICK_STRIDES, "haar", 100)
    sbhe, drawn, square, columns = (row["psnr_db"] for row in noiselets.evaluate(Options(quick=True)).rows)
    assert drawn == pytest.approx(sbhe, abs=0.5)
    assert square < drawn - 0.5
    assert columns < square
