"""The benchmark verb: its subjects, what it refuses, and what must show."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError
from evaluation.bench import arrays, missing, reconstruct, skins
from evaluation.bench.command import bench
from evaluation.bench.problem import Method, compare, make_problem
from evaluation.bench.scenes import make_scenes, mean_psnr
from reconstructor.bases import wavelet_basis
from skin.layout import load_layout
from skin.psnr import psnr_series_db
from touch.trajectory import ACQUISITION_OBJECTS


@pytest.fixture
def _brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look for the minimum in a tenth of the benchmark's iterations, and solve for a moment in each turn."""
    monkeypatch.setattr("evaluation.bench.problem.EXACT", 300)
    monkeypatch.setattr("evaluation.bench.timing.TURN_S", 0.001)


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    for subject, figure, says in (
        ("images", "x.svg", "only 'missing' has a figure"),
        ("missing", "curves.txt", r"ends in \.png, \.svg, \.pdf"),
        ("missing", "no/such/folder/curves.svg", "folder for the picture does not exist"),
    ):
        with pytest.raises(InputError, match=says):
            bench(subject, figure=Path(figure))  # type: ignore[arg-type]  # of a loop
    with pytest.raises(InputError, match="1 round or more"):
        bench("skins", rounds=0)
    with pytest.raises(InputError, match="leave out --rounds"):
        bench("images", rounds=1)
    with pytest.raises(InputError, match="only 'images' takes meshes"):
        bench("missing", meshes=tmp_path)
    with pytest.raises(InputError, match="expected a folder of meshes"):
        bench("images", meshes=tmp_path / "none")
    for subject, options in (("skins", {"device": "gpu"}), ("reconstruct", {"library": "torch"})):
        with pytest.raises(InputError, match="--device is of 'reconstruct', and --library of --device"):
            bench(subject, **options)  # type: ignore[arg-type]  # of a loop
    with pytest.raises(InputError, match="NumPy computes on a CPU"):
        bench("reconstruct", device="gpu", library="numpy")


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


def test_images_are_judged_on_the_papers_objects_and_their_noise() -> None:
    rows = list(make_scenes(load_layout().phi(), speed=700))
    assert [scene.name for scene in rows] == list(ACQUISITION_OBJECTS)
    for scene in rows:
        assert scene.true.shape == scene.felt.shape == (6, 64, 64)
        assert psnr_series_db(scene.true, scene.true) == pytest.approx(200)
        assert 27 < psnr_series_db(scene.true, scene.felt).mean() < 30  # the paper's sensors: 28.2 to 29.1 dB


def test_means() -> None:
    rows = [{"a": 1, "psnr_db": 2.0}, {"a": 2, "psnr_db": 5.0}, {"a": 1, "psnr_db": 4.0}]
    assert mean_psnr(rows, "a") == [{"a": 1, "psnr_db": 3.0}, {"a": 2, "psnr_db": 5.0}]


def test_skins_are_timed_on_one_thread_and_on_more(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("evaluation.bench.timing.TURN_S", 0.001)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    rows = skins.run(rounds=1)["rows"]
    assert [(row["skins"], row["threads"]) for row in rows] == [(1, 1), (2, 1), (2, 2), (4, 1), (4, 2), (8, 1), (8, 2)]
    assert all(row["ms"] > 0 and (row["threads"] > 1 or row["speed_up"] == 1) for row in rows)


def test_tables_cut_nothing_off(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    name = "SigPy LinearLeastSquares, operator"
    rows = [{"method": name, "dtype": "float32", "gap": 2.68756e-05, "ratio_to_ours": 155.77}]
    monkeypatch.setattr(skins, "run", lambda **_: {"rows": rows, "others": {"least_ms": 0.0922}})
    bench("skins", rounds=1)
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


@pytest.mark.slow
@pytest.mark.usefixtures("_brief")
def test_arrays_are_timed_against_the_compiled_solvers_and_equal_them(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(arrays, "CYCLES", {False: 40})
    bench("reconstruct", rounds=1, device="cpu", json=True)
    result = json.loads(capsys.readouterr().out)
    assert "NumPy" in result["device"][0]["library"]
    assert {row["images"] for row in result["batches"]} == set(arrays.BATCHES[False])
    assert all(row["ratio"] > 0 and row["difference_un"] < 1 for row in result["batches"])
    assert [row["solver"] for row in result["recordings"]] == ["live", "paper"]
    assert all(row["difference_un"] < 50 and row["largest_loss_db"] < 0.01 for row in result["recordings"])


@pytest.mark.slow
def test_missing_blocks_cost_little(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(missing, "make_scenes", lambda phi, speed: itertools.islice(make_scenes(phi, 6 * speed), 2))
    bench("missing", rounds=1, figure=tmp_path / "curves.svg", json=True)
    rows = json.loads(capsys.readouterr().out)["rows"]
    curves = {
        (method, kind): [row["psnr_db"] for row in rows if (row["method"], row["kind"]) == (method, kind)]
        for method in missing.METHODS
        for kind in ("dead_nodes", "loss_ratio")
    }
    for (method, kind), curve in curves.items():
        assert len(curve) == 7, (method, kind)
        assert all(later < earlier + 0.1 for earlier, later in itertools.pairwise(curve))
        assert curve[0] - curve[4] < 1  # 8 dead nodes of 128, or a tenth of the frames
    assert "<svg" in (tmp_path / "curves.svg").read_text()
