"""The images of the last second compared with the truth of simulated nodes."""

from collections import deque

import numpy as np

from canskin.messages import Image, Truth
from health.window import Window
from skin.ground_truth import image_pairs, in_contact
from skin.layout import Layout
from skin.psnr import psnr_db


class Comparison:
    """PSNR of images and of the sensor, in decibels.

    Parameters
    ----------
    span_s : float
        The means are of this time.
    """

    def __init__(self, layout: Layout, span_s: float) -> None:
        self._taxels, self._span_s = layout.taxels, span_s
        self._pairing = image_pairs(layout)
        #: Image, truth, and when their pair was found; a pair is compared when somebody asks for its PSNR.
        self._pairs: deque[tuple[Image, Truth, float]] = deque()
        self._image_db, self._sensor_db = Window(span_s), Window(span_s)

    def take(self, message: Image | Truth, now_s: float) -> None:
        """Take an image or a truth that came at `now_s`."""
        pairs = self._pairing.take(message) if isinstance(message, Image) else self._pairing.take_truth(message)
        self._pairs += [(*pair, now_s) for pair in pairs]
        while self._pairs and self._pairs[0][2] <= now_s - self._span_s:
            self._pairs.popleft()

    def truth_of(self, image: Image) -> Truth | None:
        """Return the truth to be shown beside an image; None if it has not come."""
        return self._pairing.truth_of(image)

    def means_db(self, now_s: float) -> tuple[float | None, float | None]:
        """Return the mean PSNR of images and of the sensor over the cycles with contact; None without any."""
        while self._pairs:
            image, truth, at_s = self._pairs.popleft()
            image_db, sensor_db = self.single_db(image, truth)
            if image_db is not None and sensor_db is not None:
                self._image_db.add(at_s, image_db)
                self._sensor_db.add(at_s, sensor_db)
        return self._image_db.mean(now_s), self._sensor_db.mean(now_s)

    def single_db(self, image: Image, truth: Truth) -> tuple[float | None, float | None]:
        """Return the PSNR of an image and of the sensor; None without contact."""
        taxels = self._taxels
        true_n, sensor_n, image_n = (
            taxels.without_gaps(np.frombuffer(each, "<f4")) for each in (truth.true, truth.sensor, image.pixels)
        )
        if not in_contact(true_n, taxels.force_max_n):
            return None, None
        return psnr_db(true_n, image_n, taxels.force_max_n), psnr_db(true_n, sensor_n, taxels.force_max_n)
