"""The settled decision: a belief in each object and in no contact, which single cycles change slowly."""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from canskin.messages import UNKNOWN_OBJECT

#: Weight of the newest cycle in the settled decision: two clear cycles in a row change the label.
SETTLING: Final = 0.4
#: Weight of the newest cycle in the settled novelty. Smaller, because every object looks unknown while it is pressed
#: in.
NOVELTY_SETTLING: Final = 0.1
#: Cycles that come in less than this time weigh less, so that labels settle over times and not over numbers of cycles.
_PERIOD_NS: Final = 10_000_000
#: Largest novelty of a single cycle, relative to the limit.
_MOST_NOVELTY: Final = 3.0
#: Slope of the doubt around the limit: 50 % at a novelty of 1, 95 % at 1.5.
_DOUBT_SLOPE: Final = 6.0


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


class Seen(NamedTuple):
    """One cycle by itself.

    Attributes
    ----------
    winner : int
        Number of the most likely object.
    confidence : float
        Of the winner, if something touches the skin.
    contact : float
        Probability of contact.
    novelty : float
        Distance from the trained touches / limit beyond which an object is unknown.
    """

    winner: int
    confidence: float
    contact: float
    novelty: float


class Settling:
    """Settles decisions over cycles.

    Parameters
    ----------
    classes : sequence of str
        Names of the objects.
    weight : float
        Weight of the newest cycle; with 1 every cycle is decided alone, except unknown objects.

    Attributes
    ----------
    belief : array of float64, shape (classes + 1,)
        Its sum is 1, its last entry is "no contact".
    novelty : float
    """

    def __init__(self, classes: Sequence[str], weight: float = SETTLING) -> None:
        self.belief = np.zeros(len(classes) + 1)
        self.novelty = 0.0
        self._labels = (*classes, "")
        self._weight = weight
        self._fresh = True
        self._settled_ns = 0

    def forget(self) -> None:
        """Let the next cycle decide alone."""
        self._fresh = True

    def take(self, seen: Seen, time_ns: int | None = None) -> None:
        """Use one cycle, sampled at `time_ns`; default: 10 ms after the last."""
        periods = self._periods(time_ns)
        weight = _weight(self._weight, periods)
        if self._fresh:
            weight, self.novelty = 1.0, 0.0
        self._fresh = False
        belief, contact, confidence = self.belief, seen.contact, seen.confidence
        others = belief.size - 2
        belief *= 1.0 - weight
        belief[:-1] += weight * contact * (1.0 - confidence) / others
        belief[seen.winner] += weight * contact * (confidence - (1.0 - confidence) / others)
        belief[-1] += weight * (1.0 - contact)
        touched = contact * (1.0 - belief[-1])
        novelty = touched * min(seen.novelty, _MOST_NOVELTY)
        self.novelty += _weight(NOVELTY_SETTLING, periods) * (novelty - self.novelty)

    def decision(self) -> Decision:
        """Return the settled decision."""
        best = int(self.belief.argmax())
        if best == self.belief.size - 1:
            return Decision("", float(self.belief[best]))
        doubt = logistic(_DOUBT_SLOPE * (self.novelty - 1.0))
        if doubt > 0.5:
            return Decision(UNKNOWN_OBJECT, doubt * float(1.0 - self.belief[-1]))
        return Decision(self._labels[best], (1.0 - doubt) * float(self.belief[best]))

    def _periods(self, time_ns: int | None) -> float:
        """Return how many periods of settling have passed that did not count yet, 1 at most.

        What is over 1 counts in the next cycle, up to a period: a late cycle takes nothing from those after it.
        """
        if time_ns is None or time_ns <= self._settled_ns:
            return 1.0
        periods = min(1.0, (time_ns - self._settled_ns) / _PERIOD_NS)
        self._settled_ns = max(self._settled_ns + round(periods * _PERIOD_NS), time_ns - _PERIOD_NS)
        return periods


def _weight(weight: float, periods: float) -> float:
    """Return the weight of a cycle after part of a period, of which a cycle after a whole period has `weight`."""
    return float(1.0 - (1.0 - weight) ** periods)


def logistic(value: float) -> float:
    """Return 1 / (1 + exp(-value)), without overflow."""
    return 1.0 / (1.0 + math.exp(-max(-500.0, min(500.0, value))))
