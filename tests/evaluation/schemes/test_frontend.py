"""Front ends, on few frames of one object."""

from dataclasses import asdict, replace

import pytest

from evaluation.result import Options
from evaluation.schemes import frontend


def test_what_is_wrong_with_a_front_end_costs_quality(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frontend, "OBJECTS", ("golf-ball",))
    monkeypatch.setattr(frontend, "BLOCK_SIZES", (32,))
    shown = ("digital:", "analogue, λ", "converters of 10", "converters of 8", "offsets of sums, 10 mN")
    kept = [each for each in frontend.EFFECTS if each.words.startswith(shown)]
    kept.append(frontend.Effect("mismatch 20 %", mismatch=0.2))
    monkeypatch.setattr(frontend, "EFFECTS", kept)
    found = frontend.evaluate(Options(quick=True))
    change = {row["front end"]: row["B = 32"] for row in found.rows}
    assert list(change) == [each.words for each in kept]
    assert change["digital: a converter of 10 bits for each taxel"] > 20
    assert change["analogue, λ that fits its noise"] > change["digital: a converter of 10 bits for each taxel"] + 1
    assert -1 < change["converters of 8 bits"] < change["converters of 10 bits"] + 0.02
    assert change["mismatch 20 %"] < -0.3
    assert change["offsets of sums, 10 mN"] < -3
    assert change["offsets of sums, 10 mN, tared"] > 0.1 * change["offsets of sums, 10 mN"]


@pytest.mark.heavy
def test_gains_that_are_known_or_rolled_give_most_of_the_loss_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frontend, "OBJECTS", ("granola-box",))
    wrong = frontend.Effect("mismatch 20 %", mismatch=0.2)

    def psnr_db(effect: frontend.Effect) -> float:
        found = frontend.measure(meshes=None, seed=0, speed=60, size=32, effect=asdict(effect))
        return float(found["psnr_db"])

    lost_db = psnr_db(frontend.Effect("perfect")) - psnr_db(wrong)
    assert lost_db > 5
    assert psnr_db(replace(wrong, knows_gains=True)) - psnr_db(wrong) > 0.6 * lost_db
    assert psnr_db(replace(wrong, is_calibrated=True)) - psnr_db(wrong) > 0.6 * lost_db
