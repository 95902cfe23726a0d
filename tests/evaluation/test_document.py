"""The document on the paper, the printed numbers and the stored run agree."""

from collections import Counter
from pathlib import Path

from evaluation.printed import printed
from evaluation.reached import VERDICTS, judged, read

DOCS = Path(__file__).parents[2] / "docs"
STORED = read(DOCS / "paper.json")


def test_the_document_counts_the_numbers_of_the_stored_run() -> None:
    counts = Counter(each.verdict for each in judged(STORED.numbers))
    missed, _, worse, reached = (counts[verdict] for verdict in VERDICTS)
    told = f"Ours reach {reached}; {worse} are worse within the tolerance, {missed} are not reached"
    assert f"prints {len(STORED.numbers)} numbers of its own work. {told}" in (DOCS / "paper.md").read_text("utf-8")


def test_the_stored_run_has_every_printed_number() -> None:
    assert {each.number for each in STORED.numbers} == {each.name for each in printed().numbers}
    assert "not measured" not in {each.verdict for each in judged(STORED.numbers)}


def test_every_number_that_is_not_reached_has_a_cause_and_every_cause_a_number() -> None:
    causes = [each.cause for each in judged(STORED.numbers) if each.verdict == VERDICTS[0]]
    assert all(causes)
    assert set(causes) == {each.words for each in printed().causes}
