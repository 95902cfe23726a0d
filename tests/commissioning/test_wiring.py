"""`skin node check --live`: what is not wired as the layout says, from the counts while a finger goes over the skin."""

from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError
from commissioning.wiring_check import chains_file, corrected_order
from commissioning.wiring_findings import Finding, Place, findings_of
from skin.chains import read_chains
from tests.commissioning import wiring_errors
from tests.commissioning.wiring_errors import KINDS, found_of, layout_of, wired

MAT = layout_of("mat")


@pytest.mark.parametrize("radius", [1.5, 2.5, 3.5])
@pytest.mark.parametrize("kind", KINDS)
def test_a_wiring_error_is_found_by_a_finger_of_any_size(
    kind: str, radius: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wiring_errors, "RADIUS", radius)
    for seed in range(3):
        wrong, found = found_of(MAT, kind, seed)
        assert found == wrong


@pytest.mark.parametrize("kind", ["none", "swapped", "dead", "doubled"])
def test_a_person_strokes_the_skin(kind: str) -> None:
    wrong, found = found_of(MAT, kind, 1, knows_path=False)
    assert found == wrong


@pytest.mark.parametrize("kind", KINDS)
def test_boards_of_a_bent_skin_that_have_empty_places(kind: str) -> None:
    wrong, found = found_of(layout_of("cone"), kind, 2)
    assert found == wrong


def test_exchanged_patches_need_a_path() -> None:
    with pytest.raises(InputError, match="cannot tell"):
        found_of(layout_of("mat"), "moved", 1, knows_path=False)


@pytest.mark.parametrize(
    ("rest", "moments", "force_n", "said"),
    [
        (0, 900, 1.0, "without touch"),
        (20, 100, 1.0, "expected 400 moments"),
        (20, 900, 0.0, "nothing touched"),
    ],
)
def test_a_stroke_that_tells_too_little(rest: int, moments: int, force_n: float, said: str) -> None:
    phi = MAT.phi()
    counts = np.random.default_rng(0).normal(size=(moments, *phi.taxels_of_blocks.shape))
    counts[rest:] += 100 * force_n
    with pytest.raises(InputError, match=said):
        findings_of(phi, MAT.taxels.surface, counts, np.zeros((moments, 3)), rest)


def test_what_is_no_exchange_of_places_gets_no_file() -> None:
    with pytest.raises(InputError, match="no exchange of places"):
        corrected_order(MAT.phi(), [Finding("unclear", 3, Place(0, 1))])


@pytest.mark.parametrize("kind", ["swapped", "moved"])
def test_the_corrected_file_is_what_is_wired(kind: str, tmp_path: Path) -> None:
    phi = MAT.phi()
    order, wrong = wired(phi, kind, np.random.default_rng(5))
    findings = []
    for each in sorted(wrong, key=str):
        taxel, found = each[1], each[2]
        assert isinstance(taxel, int)
        assert isinstance(found, tuple)
        expected = (
            divmod(int(phi.place_of_taxel[taxel]), phi.block_size)
            if kind == "swapped"
            else next((other[2][0], 0) for other in wrong if other != each and isinstance(other[2], tuple))
        )
        findings.append(Finding("swapped" if kind == "swapped" else "moved", taxel, Place(*expected), (Place(*found),)))
    path = tmp_path / "boards.csv"
    path.write_text(chains_file(phi, corrected_order(phi, findings)), encoding="utf-8")
    held = [[taxel for taxel in board if taxel < phi.taxels] for board in order.tolist()]
    assert [[taxel for taxel in board if taxel >= 0] for board in read_chains(path, 10)] == held
