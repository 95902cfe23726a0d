"""The decision on a measurement: contact or not, the object or an unknown object."""

import numpy as np
import numpy.typing as npt

from canskin.messages import MIN_VALID_RATIO
from classifier.descent import descend
from classifier.missing import Completion, Factors
from classifier.model import Model
from classifier.newest_sums import NewestSums
from classifier.novelty import Regions, novelty
from classifier.observer import Observer
from classifier.settling import SETTLING, Decision, Seen, Settling, logistic
from skin.phi import Phi
from skin.ways_of_sending import SENDINGS


class Classifier:
    """Decides cycle by cycle; one instance per skin.

    Parameters
    ----------
    phi : Phi
        The Φ of the model.
    settling : float
        As `weight` of `classifier.settling.Settling`. A model of means (`Metadata.cycles` above 1) needs a stronger
        contact until `cycles` cycles have come.
    """

    def __init__(self, model: Model, phi: Phi, *, settling: float = SETTLING) -> None:
        about = model.metadata
        self._model = model
        means = not SENDINGS[about.sending].in_cycles
        self._observer = Observer(phi, model.surface, model.no_touch, means=means)
        self._newest = NewestSums(phi, about.cycles)
        self._features = np.zeros(model.offset.size)
        self._completion: Completion | None = None
        if about.features == "sums":
            self._completion = Completion(Factors(model.sum_mean, model.sum_loadings, about.sum_noise))
        self._regions = Regions(model.centres, model.whitening, model.limits)
        self._settling = Settling(about.classes, settling)
        self._cycle: int | None = None

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
            Number of the cycle; after a gap (`NewestSums.is_gap`) or a step back, past cycles are dropped.
        time_ns : int, optional
            When the sums were sampled, by the same clock in all calls. Default: 10 ms after the last.
        """
        step = 1
        if cycle is not None:
            step = 1 if self._cycle is None else cycle - self._cycle
            self._cycle = cycle
        if self._newest.is_gap(step):
            self._settling.forget()
        valid_ratio = self._newest.take(sums, valid, step)
        if valid_ratio < MIN_VALID_RATIO:
            self._settling.forget()
            return Decision("", 0.0, blind=True)
        self._settling.take(self._look(valid_ratio), time_ns)
        return self._settling.decision()

    def _look(self, valid_ratio: float) -> Seen:
        """Return what the newest sums show."""
        model, about, newest = self._model, self._model.metadata, self._newest
        peak = self._observer.look(newest.sums, newest.valid, valid_ratio, newest.noise_ratio, self._cycle or 1)
        if self._completion is None:
            np.copyto(self._features, self._observer.features)
        else:
            np.copyto(self._features, newest.sums)
            if valid_ratio < 1:
                self._completion.complete(self._features, newest.valid_sums())
        self._features -= model.offset
        self._features *= model.scale
        winner, confidence = descend(self._features, model.weights, model.biases, len(about.classes))
        slack = 1.0 + about.unknown_slack * (1.0 - valid_ratio)
        newness = novelty(self._observer.features, self._regions) / slack
        return Seen(winner, confidence, logistic(peak - about.contact_threshold), newness)
