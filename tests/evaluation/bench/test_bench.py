"""The benchmark verb: its subjects, what it refuses, and what must show."""

import json

import numpy as np
import pytest

from canskin.errors import InputError
from evaluation.bench import classify, reconstruct
from evaluation.bench.command import bench
from evaluation.bench.problem import Method, compare, make_problem
from reconstructor.bases import wavelet_basis


@pytest.fixture
def _brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for the minimum in a tenth of the benchmark's iterations, and solve for a moment in each turn."""
    monkeypatch.setattr("evaluation.bench.problem.EXACT", 300)
    monkeypatch.setattr("evaluation.bench.timing.TURN_S", 0.001)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="1 round or more"):
        bench("classify", rounds=0)


@pytest.mark.slow
@pytest.mark.usefixtures("_brief")
def test_comparison_measures_gap_and_quality() -> None:
    problem = make_problem(wavelet_basis("haar-pyramid", 64, 64), 0.0125, lipschitz=32.0)
    rows = compare(
        problem,
        [
            Method("nothing", "float64", lambda: np.zeros(4096), np.asarray),
            Method("start", "float64", lambda: problem.start, np.asarray),
        ],
        rounds=2,
    )
    assert [row["method"] for row in rows] == ["nothing", "start"]
    assert rows[0]["gap"] > rows[1]["gap"] > 0
    assert rows[1]["psnr_db"] > rows[0]["psnr_db"]
    assert rows[0]["psnr_db"] == pytest.approx(10 * np.log10(4e-4 / np.mean(problem.true**2)))


def test_tables_cut_nothing_off(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    name = "SigPy LinearLeastSquares, operator"
    rows = [{"method": name, "dtype": "float32", "gap": 2.68756e-05, "ratio_to_ours": 155.77}]
    monkeypatch.setattr(classify, "run", lambda _: {"rows": rows, "others": {"least_ms": 0.0922}})
    bench("classify", rounds=1)
    said, words = capsys.readouterr()
    assert words == ""
    for part in (name, "ratio_to_ours", "2.688e-05", "155.8", "least_ms", "0.0922"):
        assert part in said


@pytest.mark.slow
@pytest.mark.usefixtures("_brief")
def test_ours_is_as_close_to_the_minimum_as_dense_fista() -> None:
    result = reconstruct.run(rounds=1)
    for rows in (result["rows"], result["contourlet"]):
        dense = {row["dtype"]: row for row in rows if row["method"] == "NumPy dense"}
        for row in rows:
            if row["method"] == "canskin":
                assert row["gap"] == pytest.approx(dense[row["dtype"]]["gap"], rel=0.05)
    assert json.loads(json.dumps(result)) == result
