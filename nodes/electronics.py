"""The nodes' taxel readings: the sensor signal in ADC counts, the calibration of each node, and test patterns."""

from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from canskin.messages import Truth
from dbc.board_sums import pattern_counts
from nodes.averaging import SampleFilter
from skin.defects import NO_DEFECTS, Defects
from skin.layout import Taxels
from skin.sources import Frame
from skin.taxel import NOISE_N, Memory, TaxelModel, corrected, to_counts, to_newtons


class Calibration:
    """Corrections and test patterns of all taxels of a skin, row-major.

    Parameters
    ----------
    taxels : Taxels
        Range and resolution.
    places : int, optional
        Number of taxels and of empty places of the boards, which follow; without it of taxels alone.

    Attributes
    ----------
    gain, offset : array of float32, shape (places,)
        Correction per taxel: ``gain * counts + offset``, in counts.
    taxels : Taxels
        As given.
    """

    def __init__(self, taxels: Taxels, places: int | None = None) -> None:
        self.taxels = taxels
        self.gain = np.ones(places or taxels.count, np.float32)
        self.offset = np.zeros_like(self.gain)
        #: What a test pattern shows, in counts; -1 without one.
        self.pattern = np.full(self.gain.shape, -1, np.int32)

    def set_pattern(self, chain: npt.NDArray[np.intp], pattern: int) -> None:
        """Set the test pattern of one block; `chain` holds its taxels in chain order."""
        shown = pattern_counts(pattern, chain.size, self.taxels.count_max)
        self.pattern[chain] = -1 if shown is None else shown


class Electronics(Calibration):
    """The analogue side of a skin.

    Parameters
    ----------
    taxels : Taxels
        Range and resolution.
    noise_n : float
        Standard deviation of the sensor noise in newtons.
    seed : int
        Same seed, same noise.
    period_s : float
        Time between two steps of the touch, the period of SYNC; drift, damper and creep need it.
    samples : int
        Samples of every taxel in one step, the last one at the step's instant. Between two steps the force is
        interpolated. More than one are averaged (`nodes.averaging`).
    blocks : array of int, shape (blocks, block size), optional
        Taxels and empty places of each block: more than one sample are averaged here, not by the boards.
    places : int, optional
        As for `Calibration`.

    Attributes
    ----------
    sampled : array of int32, shape (places,)
        What every place read at the newest step, corrected; not averaged.
    unread : deque of array of int32, shape (samples, places)
        What the places read at the newest two steps, not corrected; who uses the samples takes them out.
    sampled_ahead : int
        The step that `prepare` has sampled and `read` has not taken yet; -1 for none.
    """

    def __init__(
        self,
        taxels: Taxels,
        *,
        noise_n: float = NOISE_N,
        seed: int = 0,
        defects: Defects = NO_DEFECTS,
        period_s: float = 0.01,
        samples: int = 1,
        blocks: npt.NDArray[np.intp] | None = None,
        places: int | None = None,
    ) -> None:
        super().__init__(taxels, places)
        self.sampled = np.zeros(self.gain.shape, np.int32)
        self._model = TaxelModel(noise_n, taxels.force_max_n, defects)
        self._random = np.random.Generator(np.random.SFC64(seed))
        self.period_s = period_s
        self._last: tuple[int, npt.NDArray[np.float32]] | None = None
        self._memory: Memory = {}
        self._samples = samples
        self._filter = SampleFilter(blocks, self.gain.size) if blocks is not None and samples > 1 else None
        self._felt = np.zeros_like(self.sampled)
        self.sampled_ahead = -1
        self.unread: deque[npt.NDArray[np.int32]] = deque(maxlen=2)

    @property
    def signal_n(self) -> npt.NDArray[np.float32]:
        """The sensor signal at the newest step, newtons, shape (n,)."""
        return to_newtons(self.sampled[: self.taxels.count], self.taxels)

    def truth(self, frame: Frame, step: int, counter: int, time_ns: int) -> Truth:
        """Return what was true at the newest step, that of a SYNC, and what the sensor showed of it."""
        return Truth(
            step=step,
            sync_counter=counter,
            sampled_mono_ns=time_ns,
            true=frame.force_n.astype("<f4").tobytes(),
            sensor=self.signal_n.astype("<f4").tobytes(),
            label=frame.label,
        )

    @property
    def averages(self) -> bool:
        """Whether samples are averaged: then every step has to be read, or prepared, after the one before."""
        return self._filter is not None

    def drifted_n(self, step: int) -> npt.NDArray[np.float32]:
        """Return how far the zeros of the taxels have drifted by place at `step`, newtons, shape (rows, columns)."""
        return self._model.drifted_n((self.taxels.rows, self.taxels.columns), self.period_s * max(0, step))

    def prepare(self, force_n: npt.NDArray[np.float32], step: int) -> None:
        """Sample the forces at `step` before they are asked for: noise and average take most of the time."""
        if step == self.sampled_ahead:
            return
        moments_n = self._moments_n(force_n, step)
        count = len(moments_n)
        time_s = self.period_s * (step - 1 + np.arange(1, count + 1) / count)
        signal = self._model.signal_of_moments(moments_n, self._random, time_s)
        counts = np.zeros((count, self.gain.size), np.int32)
        counts[:, : self.taxels.count] = to_counts(signal.reshape(count, -1), self.taxels)
        for stop in self._model.defects.stops:
            for place in np.flatnonzero(time_s >= stop.start_s).tolist():
                counts[place, stop.taxels] = (counts[place - 1] if place else self._felt)[stop.taxels]
        self._felt, self.sampled_ahead = counts[-1], step
        self.unread.append(counts)
        if self._filter is not None:
            self._filter.take(counts.astype(np.float32))

    def read(self, force_n: npt.NDArray[np.float32], step: int = 0) -> npt.NDArray[Any]:
        """Return what the sums are made of, corrected, shape (places,).

        Of true forces, shape (rows, columns), at `step`: ADC counts, int32; where samples are averaged, averages of
        counts, float32.
        """
        self.prepare(force_n, step)
        self.sampled_ahead = -1
        self.sampled = np.rint(self._corrected(self._felt)).astype(np.int32)
        np.copyto(self.sampled, self.pattern, where=self.pattern >= 0)
        if self._filter is None:
            return self.sampled
        averages = self._corrected(self._filter.counts)
        np.copyto(averages, self.pattern, where=self.pattern >= 0, casting="unsafe")
        return averages

    def restart(self, block: int) -> None:
        """Begin the averages of a block anew."""
        if self._filter is not None:
            self._filter.restart(block)

    def _corrected(self, counts: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        return corrected(counts, self.gain, self.offset, self.taxels)

    def _moments_n(self, force_n: npt.NDArray[np.float32], step: int) -> npt.NDArray[np.float32]:
        """Return the forces of the samples up to `step`, with damper and creep: the speed is that since the last."""
        last_step, last_n = self._last or (step, force_n)
        self._last = step, force_n
        if step <= last_step:
            last_step, last_n = step - 1, force_n
        parts = (np.arange(1, self._samples, dtype=np.float32) / self._samples)[:, None, None]
        moments_n = np.concatenate([last_n[None], last_n + parts * (force_n - last_n), force_n[None]])
        period_s = (step - last_step) * self.period_s / self._samples
        damped_n = self._model.damped_n(moments_n, period_s)[1:]
        felt_n, self._memory = self._model.remembered_n(damped_n, self._memory, period_s)
        return felt_n
