"""The test vectors for stepped firmware are what a virtual board and a receiver make of the same samples."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from dbc.contract import Contract
from dbc.steps import CHECK, SET, SLOTS, STEP
from nodes.sending import vector_files
from skin.layout import load_layout
from tests.nodes.stepped_bus import Part

pytestmark = pytest.mark.heavy

BUSES = ["steps", "steps-fd"]


@cache
def vectors_of(name: str) -> tuple[Contract, dict[str, Any]]:
    contract = Contract.from_layout(load_layout(Path(name)))
    ((path, text),) = vector_files(contract).items()
    assert path == "vectors/bus0-001.json"
    return contract, json.loads(text)


@pytest.mark.parametrize("name", BUSES)
def test_words_say_what_a_receiver_makes_of_them(name: str) -> None:
    contract, vectors = vectors_of(name)
    forms = {(form.sums, bool(form.has_first)): form for form in contract.forms_of(0)}
    assert len(vectors["words"]) == 18 * len(forms)
    for case in vectors["words"]:
        part = Part(forms[case["sums"], case["has_first"]], SLOTS)
        part.known[:] = case["known"]
        # The word before came in the slot before.
        part.sent, part.slot, part._is_chained, part.missing = case["sent"] - 1, case["slot"] - 1, True, set()
        part.take(case["slot"] % 240 + 1, int.from_bytes(bytes.fromhex(case["word"]), "little"), case["slot"])
        assert part.kinds == [{"step": STEP, "set": SET, "check": CHECK}[case["kind"]]]
        assert (part.gaps, part.different, part.sent, part.slot) == (0, 0, case["sent"], case["slot"])
        assert part.known.tolist() == case["then_known"]
