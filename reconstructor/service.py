"""The reconstructor's loop: one measurement in, one image and its contacts out.

With adaptive sending only the newest measurement counts: it holds everything that the ones before held.
"""

import time
from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.fabric import Exchange
from canskin.messages import CONTACTS, IMAGE, MEASUREMENT, Contacts, Image, Measurement
from canskin.sums import doubtful_taxels
from reconstructor.adaptive import AdaptiveReconstructor
from reconstructor.contacts import ContactTracker
from reconstructor.engine import Reconstructor
from reconstructor.gains import GainCorrection, KnownGains
from skin.layout import Layout
from skin.measured_sums import MeasurementReader, decode_adaptive, decode_measurement, used_blocks
from skin.service import StopSignal, request_real_time, yield_processor

#: Measurements that wait during a solve; a longer queue would only make images older.
MAILBOX_DEPTH: Final = 4
#: Period of the check of the stop signal while no measurement comes.
PATIENCE_S: Final = 0.1

Image_n = npt.NDArray[np.float32]


class ReconstructorService:
    """Publishes an image and its contacts for every measurement with this skin's Φ.

    A measurement without valid blocks gives an image of zeros with ``valid_sums`` 0. So the page can distinguish a
    silent skin from a silent reconstructor.

    Parameters
    ----------
    layout : Layout
    solver : Reconstructor or AdaptiveReconstructor
        For the layout's Φ and grid, and its way of sending.
    fabric : Exchange
    gains : KnownGains, optional
        Of taxels and sums; only with synchronous sending.
    clock_ns : callable, optional
        Monotonic time: when an image is published.

    Attributes
    ----------
    images : int
        Number of published images.
    """

    def __init__(
        self,
        layout: Layout,
        solver: Reconstructor | AdaptiveReconstructor,
        fabric: Exchange,
        *,
        gains: KnownGains | None = None,
        clock_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.images = 0
        self._clock_ns = clock_ns
        self._work: _Adaptive | _Cycles
        if isinstance(solver, AdaptiveReconstructor):
            self._work, depth = _Adaptive(layout, solver), 1
        else:
            self._work, depth = _Cycles(layout, solver, gains), MAILBOX_DEPTH
        self._tracker = ContactTracker(layout.taxels.rows, layout.taxels.columns)
        self._phi = layout.phi()
        self._fabric = fabric
        self._mailbox = fabric.mailbox(MEASUREMENT, depth)

    @property
    def refused(self) -> int:
        """Number of measurements with another Φ or other sizes."""
        return self._work.reader.refused

    @property
    def overrun(self) -> int:
        """Number of measurements dropped because newer measurements came before their turn."""
        return self._mailbox.overrun

    def run(self, stop: StopSignal) -> None:
        """Serve until `stop`."""
        if self._phi.shape[0] >= self._phi.blocks:
            request_real_time()
        else:
            yield_processor()  # fewer sums than blocks give poor images: the label counts
        while not stop.is_set():
            measurement = self._mailbox.get(PATIENCE_S)
            if measurement is not None:
                self.take(measurement)

    def take(self, measurement: Measurement) -> None:
        """Solve and publish one measurement, or refuse it."""
        solved = self._work.solve(measurement)
        if solved is not None:
            self._publish(measurement, *solved)

    def _publish(self, measurement: Measurement, image: Image_n, valid_sums: int, solve_s: float) -> None:
        self.images += 1
        message = Image(
            cycle=measurement.cycle,
            sync_counter=measurement.sync_counter,
            sampled_mono_ns=measurement.sampled_mono_ns,
            sampled_error_ns=measurement.sampled_error_ns,
            published_mono_ns=self._clock_ns(),
            pixels=image.astype("<f4", copy=False).tobytes(),
            valid=used_blocks(measurement, self._phi).tobytes(),
            valid_sums=valid_sums,
            solve_s=solve_s,
            number=self.images,
            doubtful=measurement.doubtful,
        )
        self._fabric.publish(IMAGE, message)
        self._fabric.publish(CONTACTS, self._contacts(message, image))

    def _contacts(self, message: Image, image: Image_n) -> Contacts:
        """Find the contacts of an image; an image without any valid sum says nothing of them."""
        started_s = time.perf_counter()
        is_blind = message.valid_sums == 0
        valid = np.frombuffer(message.valid, np.bool_)[self._phi.block_of_taxel].reshape(image.shape)
        doubtful = doubtful_taxels(message, image.size)
        found, ended = ([], []) if is_blind else self._tracker.take(image, message.sampled_mono_ns, valid, doubtful)
        return Contacts(
            cycle=message.cycle,
            sync_counter=message.sync_counter,
            sampled_mono_ns=message.sampled_mono_ns,
            sampled_error_ns=message.sampled_error_ns,
            contacts=found,
            ended=ended,
            find_s=time.perf_counter() - started_s,
            blind=is_blind,
        )


class _Cycles:
    """Images of cycles."""

    def __init__(self, layout: Layout, solver: Reconstructor, gains: KnownGains | None) -> None:
        self._newton_per_count = np.float32(layout.taxels.newton_per_count)
        self._gains = None if gains is None else GainCorrection(layout.phi(), gains)
        self._solver = solver
        self.reader = MeasurementReader(layout.phi(), "reconstructor", decode_measurement)

    def solve(self, measurement: Measurement) -> tuple[Image_n, int, float] | None:
        """Return image, number of sums used, and time of the solver; None if the measurement is refused."""
        sums = self.reader.read(measurement)
        if sums is None:
            return None
        started_s = time.perf_counter()
        sums_n = np.multiply(sums.counts, self._newton_per_count, dtype=np.float32)
        valid_sums = sums.valid_sums
        if self._gains is None:
            image = self._solver.solve(sums_n, valid_sums)
        else:
            sums_n, valid_sums = self._gains.apply(sums_n, valid_sums)
            image = self._solver.solve(sums_n, valid_sums)
            self._gains.keep(image)
        return image, int(np.count_nonzero(valid_sums)), time.perf_counter() - started_s


class _Adaptive:
    """Images of the newest sums."""

    def __init__(self, layout: Layout, solver: AdaptiveReconstructor) -> None:
        self._solver = solver
        self.reader = MeasurementReader(layout.phi(), "reconstructor", decode_adaptive)

    def solve(self, measurement: Measurement) -> tuple[Image_n, int, float] | None:
        """Return image, number of sums used, and time of the solver; None if the measurement is refused."""
        sums = self.reader.read(measurement)
        if sums is None:
            return None
        started_s = time.perf_counter()
        image = self._solver.solve(sums)
        return image, int(np.count_nonzero(sums.known)), time.perf_counter() - started_s
