"""The decision on one measurement: contact or not, which object, and how surely. NumPy alone."""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from classifier.dag import DecisionGraph
from classifier.features import Smoothed
from classifier.model import Model
from skin.measurement import Sbhe

#: With fewer blocks than this part of the skin, nothing is said.
MIN_VALID_RATIO: Final = 0.25
#: Part of the newest cycle in the settled decision: two clear cycles in a row change the label.
SETTLING: Final = 0.4
#: After this many missing cycles the past says nothing any more.
FORGET_CYCLES: Final = 10
#: A block that is missing keeps its last sums for this many cycles, then it is left out.
HOLD_CYCLES: Final = 4
#: Peaks below this part of their no-touch mean count as this part of it.
_LEAST_PEAK: Final = 0.05


class Decision(NamedTuple):
    """A label, empty without contact, and its confidence in 0..1."""

    label: str
    confidence: float


class Observer:
    """Turns measurements into the features a model was trained on; arrays are reused, not allocated.

    Parameters
    ----------
    phi : Sbhe
    rows, columns : int
    no_touch : array, shape (4, widths)
        See `classifier.model`.
    """

    def __init__(self, phi: Sbhe, rows: int, columns: int, no_touch: npt.NDArray[np.float64]) -> None:
        self.smoothed = Smoothed(phi, rows, columns)
        self._energy_mean, self._energy_sd, self._peak_mean, self._peak_sd = no_touch.copy()
        widths = self._peak_mean.size
        self._standard = np.zeros(widths)
        #: Features of the newest `look`: asinh of the standardised energies, log of the relative peaks.
        self.features = np.zeros(2 * widths)

    def look(self, sums: npt.NDArray[np.int32], valid: npt.NDArray[np.float32], valid_ratio: float) -> float:
        """Fill `features` and return the largest standardised peak."""
        smoothed, standard, half = self.smoothed, self._standard, self._standard.size
        smoothed.measure(sums, valid, valid_ratio)
        np.subtract(smoothed.energies, self._energy_mean, out=standard)
        standard /= self._energy_sd
        np.arcsinh(standard, out=self.features[:half])
        np.divide(smoothed.peaks, self._peak_mean, out=standard)
        np.maximum(standard, _LEAST_PEAK, out=standard)
        np.log(standard, out=self.features[half:])
        np.subtract(smoothed.peaks, self._peak_mean, out=standard)
        standard /= self._peak_sd
        return float(standard.max())


class Classifier:
    """Decides cycle by cycle; one instance follows one skin.

    Parameters
    ----------
    model : Model
    phi : Sbhe
        The Φ the model was trained for.
    settling : float
        Part of the newest cycle in the settled decision; 1 takes every cycle for itself.
    """

    def __init__(self, model: Model, phi: Sbhe, *, settling: float = SETTLING) -> None:
        about = model.metadata
        self._model = model
        self._labels = (*about.classes, "")
        self._graph = DecisionGraph(len(about.classes))
        self._observer = Observer(phi, about.rows, about.columns, model.no_touch)
        self._held = np.zeros(about.sums, np.int32)
        self._age = np.full(phi.blocks, HOLD_CYCLES, np.int32)
        self._came = np.ones(phi.blocks, np.bool_)
        self._came_sums = np.ones(about.sums, np.bool_)
        self._valid = np.ones(phi.blocks, np.float32)
        self._valid_sums = np.ones(about.sums, np.float32)
        self._block_of_sum = np.ascontiguousarray(phi.block_of_sum)
        self._features = np.zeros(model.offset.size)
        self._margins = np.zeros(model.biases.size)
        self._settling = settling
        self._belief = np.zeros(len(self._labels))
        self._fresh = True
        self._cycle: int | None = None

    def decide(self, sums: npt.NDArray[np.int32], valid: npt.NDArray[np.uint8], cycle: int | None = None) -> Decision:
        """Return the settled decision after one more measurement.

        Parameters
        ----------
        sums : array of int32, shape (m,)
            ADC counts.
        valid : array of uint8, shape (blocks,)
            Sums of blocks that are 0 here are ignored; see `HOLD_CYCLES`.
        cycle : int, optional
            Number of the cycle; after a gap of more than `FORGET_CYCLES`, or a step back, the past is forgotten.
        """
        step = 1
        if cycle is not None:
            step = 1 if self._cycle is None else cycle - self._cycle
            self._cycle = cycle
        if not 0 < step <= FORGET_CYCLES:
            self._fresh = True
            self._age.fill(HOLD_CYCLES)
        valid_ratio = self._gather(sums, valid, step)
        if valid_ratio < MIN_VALID_RATIO:
            self._fresh = True
            return Decision("", 0.0)
        winner, confidence, contact = self._observe(valid_ratio)
        self._settle(winner, confidence, contact)
        best = int(self._belief.argmax())
        return Decision(self._labels[best], float(self._belief[best]))

    def _gather(self, sums: npt.NDArray[np.int32], valid: npt.NDArray[np.uint8], step: int) -> float:
        """Take the new sums and the recent ones of missing blocks; return the part of the blocks in use."""
        np.not_equal(valid, 0, out=self._came)
        np.take(self._came, self._block_of_sum, out=self._came_sums, mode="clip")
        np.copyto(self._held, sums, where=self._came_sums)
        self._age += max(1, min(step, HOLD_CYCLES))
        np.minimum(self._age, HOLD_CYCLES + 1, out=self._age)
        np.copyto(self._age, 0, where=self._came)
        np.less_equal(self._age, HOLD_CYCLES, out=self._valid, casting="unsafe")
        return float(self._valid.mean())

    def _observe(self, valid_ratio: float) -> tuple[int, float, float]:
        """Return the winning class, its confidence, and that of contact, of the gathered sums by themselves."""
        model, about = self._model, self._model.metadata
        peak = self._observer.look(self._held, self._valid, valid_ratio)
        contact = _logistic(peak - about.contact_threshold)
        if about.features == "sums":
            np.take(self._valid, self._block_of_sum, out=self._valid_sums, mode="clip")
            np.multiply(self._valid_sums, self._held, out=self._features)
        else:
            np.copyto(self._features, self._observer.features)
        self._features -= model.offset
        self._features *= model.scale
        np.dot(model.weights, self._features, out=self._margins)
        self._margins += model.biases
        return *self._graph.decide(self._margins), contact

    def _settle(self, winner: int, confidence: float, contact: float) -> None:
        """Move the belief towards one measurement; it is 1 in sum, the last entry is "no contact"."""
        belief = self._belief
        others = self._graph.classes - 1
        weight = 1.0 if self._fresh else self._settling
        self._fresh = False
        belief *= 1.0 - weight
        belief[:-1] += weight * contact * (1.0 - confidence) / others
        belief[winner] += weight * contact * (confidence - (1.0 - confidence) / others)
        belief[-1] += weight * (1.0 - contact)


def _logistic(value: float) -> float:
    return 1.0 / (1.0 + math.exp(-max(-500.0, min(500.0, value))))
