"""Skins of several sizes, few cycles of each."""

import numpy as np
import pytest

from classifier.novelty import nearest
from evaluation.result import Options
from evaluation.schemes import scaling


@pytest.mark.heavy
def test_counts_are_in_proportion_and_a_million_taxels_are_marked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaling, "QUICK_CYCLES", 60)
    found = scaling.evaluate(Options(quick=True))
    small, large, computed = found.rows
    assert [row["taxels"] for row in found.rows] == [1024, 4096, 1024**2]
    assert [row["from"] for row in found.rows] == ["run", "run", "arithmetic"]
    assert [(row["buses"], row["nodes"], row["sums"]) for row in found.rows] == [
        (1, 32, 256),
        (4, 128, 1024),
        (1024, 128 * 256, 1024 * 256),
    ]
    # 64 TPDOs of 8 bytes and a SYNC on a bus, a hundred times a second; frames of 8 bytes have 111 to 135 bits.
    assert 0.64 * 1.11 < small["mbit_per_s"] < 0.64 * 1.36
    assert large["mbit_per_s"] == pytest.approx(4 * small["mbit_per_s"], rel=0.05)
    assert large["psnr_db"] == pytest.approx(small["psnr_db"], abs=3)
    assert min(small["psnr_db"], large["psnr_db"]) > small["sensor_db"] + 10
    assert large["solver_mb"] == pytest.approx(4 * small["solver_mb"], rel=0.2)
    assert computed["psnr_db"] is computed["right_percent"] is None
    assert len({tuple(row) for row in found.rows}) == 1
    for picture in found.pictures:
        picture.draw()


def test_arrays_count_once() -> None:
    array = np.zeros((10, 10))
    assert scaling.held_bytes([array, array[2:], {"again": array}, np.zeros(3, np.uint8)]) == 803


def test_arrays_of_a_compiled_function_do_not_count() -> None:
    array = np.zeros((10, 10))
    nearest(np.zeros(3), np.zeros((2, 3)), np.zeros((2, 3, 3)))
    assert scaling.held_bytes([array, nearest]) == 800
