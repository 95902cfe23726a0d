"""The document on the paper, the printed numbers and the stored run agree."""

import json
from pathlib import Path

import pytest

from docs.paper import DOCUMENT, PARTS, RESULTS, made, main
from evaluation.printed import printed
from evaluation.reached import VERDICTS, judged, read

STORED = read(RESULTS)


def test_the_document_is_made_from_the_stored_run() -> None:
    text = DOCUMENT.read_text("utf-8")
    assert made(text, STORED) == text
    assert all(f"<!-- made: {name} -->" in text for name in PARTS)


def test_the_stored_run_has_every_printed_number() -> None:
    assert {each.number for each in STORED.numbers} == {each.name for each in printed().numbers}
    assert "not measured" not in {each.verdict for each in judged(STORED.numbers)}


def test_every_number_that_is_not_reached_has_a_cause_and_every_cause_a_number() -> None:
    causes = [each.cause for each in judged(STORED.numbers) if each.verdict == VERDICTS[0]]
    assert all(causes)
    assert set(causes) == {each.words for each in printed().causes}


def test_a_run_that_lacks_a_number_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lacking = json.loads(RESULTS.read_text("utf-8"))
    lacking["numbers"][5]["ours"] = None
    path = tmp_path / "paper.json"
    path.write_text(json.dumps(lacking))
    before = RESULTS.read_text("utf-8")
    assert main([str(path)]) == 2
    assert "lacks numbers: 1, such as" in capsys.readouterr().err
    assert RESULTS.read_text("utf-8") == before
