"""The decision on a measurement: contact or not, the object or an unknown object, and the confidence."""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.labels import MIN_VALID_RATIO
from canskin.messages import UNKNOWN_OBJECT
from classifier.descent import descend
from classifier.missing import Completion, Factors
from classifier.model import Model
from classifier.newest_sums import NewestSums
from classifier.novelty import Regions, novelty
from classifier.observer import Observer
from classifier.used_sums import USED_SUMS
from skin.measurement import Sbhe

#: Weight of the newest cycle in the settled decision: two clear cycles in a row change the label.
SETTLING: Final = 0.4
#: Weight of the newest cycle in the settled novelty. Smaller, because every object looks unknown while it is pressed
#: in.
NOVELTY_SETTLING: Final = 0.1
#: Cycles that come in less than this time weigh less, so that labels settle over times and not over numbers of cycles.
_SETTLING_PERIOD_NS: Final = 10_000_000
#: Largest novelty of a single cycle, relative to the limit.
_MOST_NOVELTY: Final = 3.0
#: Slope of the doubt around the limit: 50 % at a novelty of 1, 95 % at 1.5.
_DOUBT_SLOPE: Final = 6.0
#: After a gap of more cycles than this, or than three times those that are averaged if these are more, the decision
#: starts again.
FORGET_CYCLES: Final = 10


class Decision(NamedTuple):
    """Decision on one cycle.

    Attributes
    ----------
    label : str
        The object, `canskin.messages.UNKNOWN_OBJECT`, or empty without contact.
    confidence : float
        0 to 1.
    blind : bool
        Too few blocks came for a decision.
    """

    label: str
    confidence: float
    blind: bool = False


class Classifier:
    """Decides cycle by cycle; one instance per skin.

    Parameters
    ----------
    model : Model
    phi : Sbhe
        The Φ of the model.
    settling : float
        Weight of the newest cycle in the settled decision; with 1 every cycle is decided alone, except unknown objects.
        A model of means (`Metadata.cycles` above 1) needs a stronger contact until `cycles` cycles have come.
    """

    def __init__(self, model: Model, phi: Sbhe, *, settling: float = SETTLING) -> None:
        about = model.metadata
        self._model = model
        self._labels = (*about.classes, "")
        means = USED_SUMS[about.sending].means
        self._observer = Observer(phi, about.rows, about.columns, model.no_touch, means=means)
        self._newest = NewestSums(phi, about.cycles)
        self._features = np.zeros(model.offset.size)
        self._completion: Completion | None = None
        if about.features == "sums":
            self._completion = Completion(Factors(model.sum_mean, model.sum_loadings, about.sum_noise))
        self._regions = Regions(model.centres, model.whitening, model.limits)
        self._settling = settling
        self._belief = np.zeros(len(self._labels))
        self._novelty = 0.0
        self._fresh = True
        self._cycle: int | None = None
        self._settled_ns = 0

    def decide(
        self,
        sums: npt.NDArray[np.int32],
        valid: npt.NDArray[np.bool_],
        cycle: int | None = None,
        time_ns: int | None = None,
    ) -> Decision:
        """Return the settled decision after one more measurement.

        Parameters
        ----------
        sums : array of int32, shape (m,)
            ADC counts.
        valid : array of bool, shape (blocks,)
            Sums of blocks that are False here are ignored; see `classifier.newest_sums`.
        cycle : int, optional
            Number of the cycle; after a gap (see `FORGET_CYCLES`) or a step back, past cycles are dropped.
        time_ns : int, optional
            When the sums were sampled, by the same clock in all calls. Default: 10 ms after the last.
        """
        step = 1
        if cycle is not None:
            step = 1 if self._cycle is None else cycle - self._cycle
            self._cycle = cycle
        if not 0 < step <= max(FORGET_CYCLES, 3 * self._model.metadata.cycles):
            self._fresh = True
            self._newest.forget()
        valid_ratio = self._newest.take(sums, valid, step)
        if valid_ratio < MIN_VALID_RATIO:
            self._fresh = True
            return Decision("", 0.0, blind=True)
        self._look(valid_ratio, self._periods(time_ns))
        return self._said()

    def _periods(self, time_ns: int | None) -> float:
        """Return how many periods of settling have passed that did not count yet, 1 at most.

        What is over 1 counts in the next cycle, up to a period: a late cycle takes nothing from those after it.
        """
        if time_ns is None or time_ns <= self._settled_ns:
            return 1.0
        periods = min(1.0, (time_ns - self._settled_ns) / _SETTLING_PERIOD_NS)
        self._settled_ns = max(self._settled_ns + round(periods * _SETTLING_PERIOD_NS), time_ns - _SETTLING_PERIOD_NS)
        return periods

    def _look(self, valid_ratio: float, periods: float) -> None:
        """Update belief and novelty with the newest sums."""
        model, about, newest = self._model, self._model.metadata, self._newest
        peak = self._observer.look(newest.sums, newest.valid, valid_ratio, newest.noise_ratio)
        contact = _logistic(peak - about.contact_threshold)
        if self._completion is None:
            np.copyto(self._features, self._observer.features)
        else:
            np.copyto(self._features, newest.sums)
            if valid_ratio < 1:
                self._completion.complete(self._features, newest.valid_sums())
        self._features -= model.offset
        self._features *= model.scale
        winner, confidence = descend(self._features, model.weights, model.biases, len(about.classes))
        self._settle(winner, confidence, contact, _weight(self._settling, periods))
        slack = 1.0 + about.unknown_slack * (1.0 - valid_ratio)
        seen = min(novelty(self._observer.features, self._regions) / slack, _MOST_NOVELTY)
        touched = contact * (1.0 - self._belief[-1])
        self._novelty += _weight(NOVELTY_SETTLING, periods) * (touched * seen - self._novelty)

    def _said(self) -> Decision:
        best = int(self._belief.argmax())
        if best == self._belief.size - 1:
            return Decision("", float(self._belief[best]))
        doubt = _logistic(_DOUBT_SLOPE * (self._novelty - 1.0))
        if doubt > 0.5:
            return Decision(UNKNOWN_OBJECT, doubt * float(1.0 - self._belief[-1]))
        return Decision(self._labels[best], (1.0 - doubt) * float(self._belief[best]))

    def _settle(self, winner: int, confidence: float, contact: float, weight: float) -> None:
        """Update the belief with one measurement; its sum is 1, its last entry is "no contact"."""
        belief = self._belief
        others = belief.size - 2
        if self._fresh:
            weight, self._novelty = 1.0, 0.0
        self._fresh = False
        belief *= 1.0 - weight
        belief[:-1] += weight * contact * (1.0 - confidence) / others
        belief[winner] += weight * contact * (confidence - (1.0 - confidence) / others)
        belief[-1] += weight * (1.0 - contact)


def _weight(weight: float, periods: float) -> float:
    """Return the weight of a cycle after part of a period, of which a cycle after a whole period has `weight`."""
    return float(1.0 - (1.0 - weight) ** periods)


def _logistic(value: float) -> float:
    return 1.0 / (1.0 + math.exp(-max(-500.0, min(500.0, value))))
