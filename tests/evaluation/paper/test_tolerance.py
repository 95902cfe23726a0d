"""Counting cells against a tolerance."""

from evaluation.paper.tolerance import outside, within

ROWS = [{"object": name, "difference": value} for name, value in (("a", 0.1), ("b", -0.4), ("c", 0.6), ("d", None))]


def test_cells_within_and_beyond() -> None:
    told = within(ROWS, 0.4, what="Haar", unit="dB", least_share=0.6)
    assert "Haar: 2 of 3 cells within 0.4 dB" in told
    assert "(aim 60%: reached)" in told
    assert "0.60 dB" in told
    assert "not reached" in within(ROWS, 0.4, what="Haar", unit="dB", least_share=0.7)
    assert outside(ROWS, 0.3, unit="dB", name=lambda row: row["object"]) == "Beyond 0.3 dB: b -0.40; c +0.60."
    assert outside(ROWS, 0.6, unit="dB", name=lambda row: row["object"]) is None


def test_rows_without_a_paper_number_are_not_counted() -> None:
    assert within(ROWS[3:], 1, what="x", unit="dB", least_share=1) == "x: no cell to compare."
