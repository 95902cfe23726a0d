"""Postures of people never met, on recordings made here."""

from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError
from evaluation.recognition.postures import POSTURES, evaluate, measure_postures, people_files, read_postures
from evaluation.result import Options


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four people whose postures differ in where they press; each person weighs something else."""
    places = np.random.default_rng(0).integers(4, 28, (len(POSTURES), 3, 2))
    for person in range(4):
        rng = np.random.default_rng(person + 1)
        arrays = {}
        for name, spots in zip(POSTURES, places, strict=True):
            counts = rng.integers(0, 20, (22, 32, 32))
            for row, column in spots:
                counts[:, row - 3 : row + 4, column - 3 : column + 4] += 400 * (person + 1)
            arrays[name] = counts.astype(np.uint16)
        np.savez(tmp_path / f"S{person + 1}.npz", **arrays)
    (tmp_path / "Summary.npz").write_bytes(b"another file")
    return tmp_path


def test_frames_lie_in_the_middle_and_know_their_person(folder: Path) -> None:
    frames, postures, people = read_postures(str(folder))
    assert frames.shape == (4 * 17 * 3, 4096)
    assert (frames.min(), frames.max()) == (0, 1)
    assert not frames.reshape(-1, 64, 64)[:, :16].any()
    np.testing.assert_array_equal(np.unique(people), range(4))
    np.testing.assert_array_equal(np.unique(postures), range(17))


@pytest.mark.heavy
@pytest.mark.parametrize("variant", ["raw sums, unit length", "sums of roots, unit length, rows chosen"])
def test_person_never_met_is_recognised(folder: Path, variant: str) -> None:
    result = measure_postures(recordings=str(folder), variant=variant, size=64, draw=0, person=1)
    assert result["accuracy"] > 0.9


@pytest.mark.heavy
def test_subject_says_what_it_needs(folder: Path, tmp_path: Path) -> None:
    assert "--recordings" in evaluate(Options()).note
    found = evaluate(Options(quick=True, recordings=folder))
    assert {row["sums"] for row in found.rows} == {16}
    assert all(row["ours"] > 100 / 17 for row in found.rows)
    found.pictures[0].draw()
    (folder / "S3.npz").unlink()
    (folder / "S4.npz").unlink()
    with pytest.raises(InputError, match="3 or more people"):
        people_files(tmp_path)
