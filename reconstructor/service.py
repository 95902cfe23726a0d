"""The reconstructor's loop: one measurement in, one image and its contacts out."""

import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.fabric import Exchange
from canskin.messages import CONTACTS, IMAGE, MEASUREMENT, Contacts, EndedContact, Image, Measurement
from canskin.sums import doubtful_taxels
from reconstructor.contacts import ContactTracker
from reconstructor.following import Following
from reconstructor.imaging import Imager
from shell.pulse import Beat, unheard
from shell.service import StopSignal, request_real_time, yield_processor
from skin.layout import Layout
from skin.measured_sums import MeasurementReader
from skin.phi import Phi

#: Period of the check of the stop signal while no measurement comes.
PATIENCE_S: Final = 0.1
#: Name of the service.
RECONSTRUCTOR: Final = "reconstructor"

Image_n = npt.NDArray[np.float32]


def warm_up(layout: Layout, imager: Imager) -> None:
    """Compile what images and contacts need, or load what was compiled."""
    imager.warm_up()
    ContactTracker(layout.taxels.surface).warm_up()


class ReconstructorService:
    """Publishes an image and its contacts for every measurement with this skin's Φ, unless another one is named to.

    A measurement without valid blocks gives an image of zeros with ``valid_sums`` 0. So the page can distinguish a
    silent skin from a silent reconstructor.

    Parameters
    ----------
    imager : Imager
        Of the layout.
    instance : str
        Of its `canskin.peers.Peer`, by which a gateway names the reconstructor that publishes.
    clock_ns : callable, optional
        Monotonic time: when an image is published.
    timer : callable, optional
        Seconds: how long an image and its contacts take.

    Attributes
    ----------
    images : int
        Number of images.
    """

    def __init__(
        self,
        layout: Layout,
        imager: Imager,
        fabric: Exchange,
        *,
        instance: str = "",
        clock_ns: Callable[[], int] = time.monotonic_ns,
        timer: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.images = 0
        self._clock_ns, self._timer = clock_ns, timer
        self._imager = imager
        self._phi = layout.operator()
        self._reader: MeasurementReader[Any] = MeasurementReader(self._phi, RECONSTRUCTOR, imager.decode)
        self._tracker = ContactTracker(layout.taxels.surface)
        self._is_measured = ~layout.taxels.is_masked
        self._measured_of = lru_cache(maxsize=1)(self._measured)
        self._fabric, self._instance = fabric, instance
        self._following = Following(self._tracker, fabric)
        self._mailbox = fabric.mailbox(MEASUREMENT, imager.depth)

    def schedule(self, tell: Callable[[str], None]) -> None:
        """Ask for the scheduling that images need; `tell` is called with what was obtained, and when it changes."""
        if self._phi.shape[0] >= self._phi.blocks:
            request_real_time(RECONSTRUCTOR, tell)
        else:
            tell(yield_processor())  # fewer sums than blocks give poor images: the label counts

    def run(self, stop: StopSignal, beat: Beat = unheard) -> None:
        """Serve until `stop`."""
        while not stop.is_set():
            measurement = self._mailbox.get(PATIENCE_S)
            if measurement is not None:
                self.take(measurement)
            beat(self.images)

    def take(self, measurement: Measurement) -> None:
        """Solve one measurement, and publish it or follow who does; or refuse it."""
        sums = self._reader.read(measurement)
        if sums is None:
            return
        started_s = self._timer()
        image, used_sums = self._imager.solve(sums)
        solve_s = self._timer() - started_s
        self.images += 1
        message = Image(
            cycle=measurement.cycle,
            sync_counter=measurement.sync_counter,
            sampled_mono_ns=measurement.sampled_mono_ns,
            sampled_error_ns=measurement.sampled_error_ns,
            published_mono_ns=self._clock_ns(),
            pixels=image.astype("<f4", copy=False).tobytes(),
            valid=sums.valid.tobytes(),
            valid_sums=int(np.count_nonzero(used_sums)),
            solve_s=solve_s,
            number=self.images + self._following.ahead,
            doubtful=measurement.doubtful,
        )
        if not measurement.names(RECONSTRUCTOR, self._instance):
            self._following.follow(self._contacts(message, image), self.images)
            return
        self._fabric.publish(IMAGE, message)
        self._fabric.publish(CONTACTS, self._contacts(message, image, self._following.take_over()))

    def _contacts(self, message: Image, image: Image_n, before: Sequence[EndedContact] = ()) -> Contacts:
        """Find the contacts of an image; an image without any valid sum says nothing of them."""
        started_s = self._timer()
        is_blind = message.valid_sums == 0
        valid = self._measured_of(self._phi.of_cycle(message.cycle), message.valid).reshape(image.shape)
        doubtful = doubtful_taxels(message, image.size)
        found, ended = ([], []) if is_blind else self._tracker.take(image, message.sampled_mono_ns, valid, doubtful)
        return Contacts(
            cycle=message.cycle,
            sync_counter=message.sync_counter,
            sampled_mono_ns=message.sampled_mono_ns,
            sampled_error_ns=message.sampled_error_ns,
            contacts=found,
            ended=[*before, *ended],
            find_s=self._timer() - started_s,
            blind=is_blind,
            number=message.number,
        )

    def _measured(self, phi: Phi, valid: bytes) -> npt.NDArray[np.bool_]:
        """Return the taxels, masked ones left out, that valid blocks measured."""
        return phi.valid_taxels(np.frombuffer(valid, np.bool_)) & self._is_measured
