"""How one measurement changes the settled decision, by arithmetic; what is seen in it is given."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from classifier import decide
from classifier.decide import Classifier
from classifier.model import Model
from classifier.newest_sums import NewestSums, averaged_cycles
from classifier.observer import Observer
from skin.measurement import Sbhe

DOME, PLATE = 0, 1


class Given:
    """A classifier of "dome" and "plate" that sees what the test says."""

    def __init__(self, model: Model, phi: Sbhe, monkeypatch: pytest.MonkeyPatch) -> None:
        assert model.metadata.classes == ["dome", "plate"]
        self.peak = model.metadata.contact_threshold  # contact or not: as likely as not
        self.winner, self.confidence, self.novelty = DOME, 0.9, 2.0
        self.classifier = Classifier(model, phi)
        self.slack = model.metadata.unknown_slack
        self._sums, self._blocks = np.zeros(phi.shape[0], np.int32), phi.blocks
        observer: Any = SimpleNamespace(look=lambda *_: self.peak, features=np.zeros(model.offset.size))
        self.classifier._observer = observer
        monkeypatch.setattr(decide, "descend", lambda *_: (self.winner, self.confidence))
        monkeypatch.setattr(decide, "novelty", lambda *_: self.novelty)

    def see(self, *, lost: int = 0, cycle: int | None = None, time_ns: int | None = None) -> decide.Decision:
        valid = np.ones(self._blocks, np.bool_)
        valid[:lost] = False
        return self.classifier.decide(self._sums, valid, cycle, time_ns)

    @property
    def belief(self) -> list[float]:
        return [float(each) for each in self.classifier._belief]

    @property
    def settled_novelty(self) -> float:
        return self.classifier._novelty


@pytest.fixture
def given(model: Model, phi: Sbhe, monkeypatch: pytest.MonkeyPatch) -> Given:
    return Given(model, phi, monkeypatch)


def test_belief_is_of_each_object_and_of_no_contact(given: Given) -> None:
    """Half of it is of contact, and nine tenths of that are of the winner."""
    given.see()
    assert given.belief == pytest.approx([0.45, 0.05, 0.5])
    given.winner = PLATE
    given.see()
    assert given.belief == pytest.approx([0.6 * 0.45 + 0.4 * 0.05, 0.6 * 0.05 + 0.4 * 0.45, 0.5])
    given.peak -= 1e9
    given.see()
    assert given.belief == pytest.approx([0.6 * 0.29, 0.6 * 0.21, 0.6 * 0.5 + 0.4])
    assert sum(given.belief) == pytest.approx(1.0)


def test_novelty_settles_by_a_tenth_and_counts_as_far_as_the_skin_is_touched(given: Given) -> None:
    given.see()
    assert given.settled_novelty == pytest.approx(0.1 * 0.25 * 2)  # contact and belief in it are a half each
    given.see()
    assert given.settled_novelty == pytest.approx(0.05 + 0.1 * (0.25 * 2 - 0.05))
    given.peak += 1e9
    given.see()
    assert given.settled_novelty == pytest.approx(0.095 + 0.1 * (0.7 * 2 - 0.095))


def test_the_novelty_of_one_cycle_is_three_at_most(given: Given) -> None:
    given.novelty = 50.0
    given.see()
    assert given.settled_novelty == pytest.approx(0.1 * 0.25 * 3)


def test_an_object_looks_newer_where_blocks_are_missing(given: Given) -> None:
    given.see(lost=16)  # of 32
    assert given.settled_novelty == pytest.approx(0.1 * 0.25 * 2 / (1 + given.slack / 2))


@pytest.mark.parametrize(("cycle", "is_new"), [(110, False), (111, True), (100, True), (99, True), (101, False)])
def test_after_ten_cycles_without_a_measurement_or_a_step_back_it_begins_anew(
    given: Given, cycle: int, *, is_new: bool
) -> None:
    for each in (99, 100):
        given.see(cycle=each)
    given.winner, given.novelty = PLATE, 0.0
    given.see(cycle=cycle)
    assert given.belief[PLATE] == pytest.approx(0.45 if is_new else 0.21)
    assert given.settled_novelty == pytest.approx(0.0 if is_new else 0.9 * 0.095)


def test_without_sums_it_is_blind_and_begins_anew(given: Given) -> None:
    given.see()
    given.winner = PLATE
    for _ in range(4):
        assert not given.see(lost=32).blind  # the last sums count for four cycles
    assert given.see(lost=32) == ("", 0.0, True)
    given.winner = DOME
    given.see()
    assert given.belief == pytest.approx([0.45, 0.05, 0.5])


def test_cycles_count_by_the_time_that_has_passed(given: Given) -> None:
    """A period is 10 ms; what a late cycle has over a period counts in the next one, up to a period."""
    times_ms = [1000, 1002, 1004, 1009, 1019, 1059, 1061, 1063]
    periods = [given.classifier._periods(time_ms * 1_000_000) for time_ms in times_ms]
    assert periods == pytest.approx([1.0, 1.0, 0.4, 0.5, 1.0, 1.0, 1.0, 0.4])
    assert given.classifier._periods(None) == 1.0
    assert given.classifier._periods(900_000_000) == 1.0


def test_two_halves_of_a_period_weigh_as_much_as_one(given: Given) -> None:
    given.see(time_ns=1_000_000_000)
    given.see(time_ns=1_010_000_000)  # what the first had over a period is used up
    given.winner = PLATE
    before = given.belief[PLATE]
    for time_ms in (1015, 1020, 1025, 1030):
        given.see(time_ns=time_ms * 1_000_000)
    passed = (1030 - 1010 + 10) / 10  # the first cycle after the pause counts as a whole one
    assert given.belief[PLATE] == pytest.approx(0.45 + (before - 0.45) * 0.6**passed)


def test_a_peak_far_from_the_threshold_is_no_overflow() -> None:
    assert decide._logistic(1e9) == 1.0
    assert decide._logistic(-1e9) == pytest.approx(0.0, abs=1e-200)
    assert decide._logistic(math.log(3)) == pytest.approx(0.75)


# Means of sums, and what the observer makes of them


@pytest.mark.parametrize(("rate_hz", "cycles"), [(500.0, 20), (100.0, 4), (40.0, 2), (20.0, 1), (10.0, 1), (1.0, 1)])
def test_sums_are_averaged_over_about_forty_milliseconds(rate_hz: float, cycles: int) -> None:
    layout: Any = SimpleNamespace(samples_per_sync=1, recognition=None, sync=SimpleNamespace(rate_hz=rate_hz))
    assert averaged_cycles(layout) == cycles
    for changed in ({"samples_per_sync": 2}, {"recognition": "some"}):
        assert averaged_cycles(SimpleNamespace(**{**vars(layout), **changed})) == 1  # type: ignore[arg-type]


def test_a_mean_of_two_cycles_has_more_noise_at_first(phi: Sbhe) -> None:
    newest, came = NewestSums(phi, 2), np.ones(phi.blocks, np.bool_)
    newest.take(np.zeros(phi.shape[0], np.int32), came, 1)
    assert newest.noise_ratio == pytest.approx(math.sqrt(2))
    single = NewestSums(phi)
    single.take(np.zeros(phi.shape[0], np.int32), came, 1)
    assert single.noise_ratio == 1.0


def test_features_and_peak_are_relative_to_the_untouched_skin(phi: Sbhe) -> None:
    """A quarter of the blocks gives a quarter of the energy, and half the peak."""
    energy_mean, energy_sd, peak_mean, peak_sd = np.array([[4.0, 1.0], [2.0, 4.0], [0.5, 8.0], [0.25, 2.0]])
    observer = Observer(phi, 32, 32, np.array([energy_mean, energy_sd, peak_mean, peak_sd]))
    seen: list[tuple[Any, ...]] = []
    smoothed: Any = SimpleNamespace(
        measure=lambda *given: seen.append(given), energies=np.array([40.0, 3.0]), peaks=np.array([6.0, 0.1])
    )
    observer.smoothed = smoothed
    sums, valid = np.zeros(phi.shape[0]), np.ones(phi.blocks, np.float32)
    peak = observer.look(sums, valid, 0.25, 2.0)
    assert [given[2] for given in seen] == [0.25]
    energies = [(40.0 - 4 * 4.0) / 2.0 / 0.25, (3.0 - 4 * 1.0) / 4.0 / 0.25]
    peaks = [6.0 / 0.5 / 0.5, 0.05]  # the second is below a twentieth of its mean
    assert observer.features.tolist() == pytest.approx([*np.arcsinh(energies), *np.log(peaks)])
    assert peak == pytest.approx((6.0 / 2 - 0.5) / 0.25)
    assert observer.look(sums, valid, 0.25) == pytest.approx((6.0 - 0.5) / 0.25)
