"""Wires against quality, on few frames of one object."""

import pytest

from evaluation.result import Options
from evaluation.schemes import wiring


def test_shorter_wires_cost_quality(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wiring, "QUICK_SPEED", 700)
    kept = {name: wiring.WIRINGS[name] for name in ("whole skin, B = 32", "16 x 16, B = 32", "4 x 8 neighbours")}
    monkeypatch.setattr(wiring, "WIRINGS", kept)
    found = wiring.evaluate(Options(quick=True, objects=("golf-ball",)))
    scattered, patch, neighbours = found.rows
    assert [row["wiring"] for row in found.rows] == list(kept)
    assert [row["boards"] for row in found.rows] == [128] * 3
    assert scattered["all_m"] == pytest.approx(165.6)
    assert scattered["all_m"] > 2 * patch["all_m"] > 4 * neighbours["all_m"]
    assert scattered["longest_m"] == pytest.approx(1.63)
    assert scattered["psnr_db"] > neighbours["psnr_db"] + 1
    assert neighbours["dead_board_db"] > scattered["dead_board_db"]
