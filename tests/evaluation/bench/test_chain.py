"""The bench of the chain: every process and every step has a figure, and the steps make up the whole."""

from pathlib import Path

import pytest

from evaluation.bench import chain
from tests.layouts import slow_layout


def test_processes_and_steps_of_a_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(chain, "LAYOUTS", (slow_layout(tmp_path, 20),))
    monkeypatch.setattr(chain, "RUN_S", 2.0)
    processors, steps = chain.run(rounds=1).values()
    assert processors[0].keys() == {"skin", "nodes", "reconstructor", "classifier", "viewer", "gateway"}
    assert all(ratio > 0 for name, ratio in processors[0].items() if name not in {"skin", "viewer"})
    assert [row["step"] for row in steps][-1] == "in all"
    assert all(row["images"] > 0 for row in steps)
    # A cycle is measured when its frames have crossed the bus; the solver has not waited for anything then.
    sample, _, solver, client, whole = (row["p50_ms"] for row in steps)
    assert min(sample, solver, client) > 0
    assert whole > sample + solver
