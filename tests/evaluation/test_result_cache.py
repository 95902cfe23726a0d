"""Measured cells: their order, what is kept, and what is measured again."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canskin.errors import InputError
from evaluation.report import write_report
from evaluation.result import Options, Result, beside
from evaluation.result_cache import measure_cells

_calls: list[int] = []


def double(number: int) -> dict[str, int]:
    _calls.append(number)
    return {"double": 2 * number}


def kinds(size: int) -> dict[str, Any]:
    _calls.append(size)
    part = np.float64(0.1)
    return {"nan": np.nan, "pair": (1, np.inf), "array": np.full(size, part), "count": np.int64(size), "part": part}


CELLS = [{"number": number} for number in (3, 1, 2)]
DOUBLED = [{"double": number} for number in (6, 2, 4)]


@pytest.fixture(autouse=True)
def _no_calls() -> None:
    _calls.clear()


@pytest.mark.heavy
def test_results_come_in_the_order_of_the_cells_from_one_process_and_from_two() -> None:
    assert measure_cells(double, CELLS, Options(), "cells") == DOUBLED
    assert measure_cells(double, CELLS, Options(jobs=2), "cells") == DOUBLED


def test_a_run_that_was_cut_short_goes_on(tmp_path: Path) -> None:
    options = Options(out=tmp_path)
    measure_cells(double, CELLS[:2], options, "cells")
    assert measure_cells(double, CELLS, options, "cells") == DOUBLED
    assert measure_cells(double, CELLS, options, "others") == DOUBLED
    assert _calls == [3, 1, 2]


def test_a_damaged_result_is_measured_again(tmp_path: Path) -> None:
    options = Options(out=tmp_path)
    measure_cells(double, CELLS, options, "cells")
    kept = [each for each in tmp_path.rglob("*") if each.is_file()]
    kept[0].write_bytes(pickle.dumps(DOUBLED[0]))
    kept[1].write_bytes(b"")
    assert measure_cells(double, CELLS, options, "cells") == DOUBLED
    assert len(_calls) == 5


def test_what_is_kept_is_what_was_measured(tmp_path: Path) -> None:
    measured = str(measure_cells(kinds, [{"size": 2}], Options(), "cells"))
    for _ in range(2):
        assert str(measure_cells(kinds, [{"size": 2}], Options(out=tmp_path), "cells")) == measured
    assert measured == "[{'nan': nan, 'pair': [1, inf], 'array': [0.1, 0.1], 'count': 2, 'part': 0.1}]"
    assert _calls == [2, 2]


def test_other_code_is_measured_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = Options(out=tmp_path)
    measure_cells(double, CELLS, options, "cells")
    monkeypatch.setattr("evaluation.result_cache.code_digest", lambda: "changed")
    measure_cells(double, CELLS, options, "cells")
    assert _calls == [3, 1, 2, 3, 1, 2]


def test_a_folder_that_cannot_be_made_is_refused(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("")
    with pytest.raises(InputError, match=r"cannot be made: .*give another --out"):
        measure_cells(double, CELLS, Options(out=tmp_path), "cells")


def test_options_that_cannot_be_used(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="expected a folder of meshes"):
        Options(meshes=tmp_path / "none")
    with pytest.raises(InputError, match=r"no mesh banana\.ply"):
        Options(meshes=tmp_path)
    with pytest.raises(InputError, match="is a file"):
        Options(out=tmp_path / "file")
    with pytest.raises(InputError, match="draws needs a whole number of 1 or more: got 0"):
        Options(draws=0)


def test_beside_the_paper() -> None:
    assert beside(1.234, 1.0) == {"ours": 1.23, "paper": 1.0, "difference": 0.23}
    assert beside(1.234, None) == {"ours": 1.23, "paper": None, "difference": None}
    assert beside(float("nan"), 1.0) == {"ours": None, "paper": 1.0, "difference": None}


def test_the_report_shows_what_it_is_given_and_no_markup_of_it(tmp_path: Path) -> None:
    found = Result("Table of <things>", [{"object": "a & b", **beside(1.5, 2.0)}], note="one <note>")
    text = write_report({"things": found}, Options(quick=True), tmp_path).read_text()
    for shown in ("Table of &lt;things&gt;", "a &amp; b", "<td>-0.5</td>", "one &lt;note&gt;", "A quick look"):
        assert shown in text
