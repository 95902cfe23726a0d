"""The ground truth of an image or a label, and the test for contact.

An image of sums of one instant belongs to the truth of its cycle. Steps and sums in turns (`sync.turns`) are of
no single instant: a truth belongs to the image that was on show at its instant. A label belongs to the truth of its
cycle; with steps, where there are no cycles, to the truth nearest to its sums.
"""

from collections import deque
from typing import Final, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from canskin.messages import CycleMeasurement, Image, Label, Truth
from skin.layout import Layout
from skin.sync_counter import SYNC_OVERFLOW

#: Messages with equal SYNC counters belong to one cycle if their SYNCs are nearer than this, and than half the time
#: after which the counter repeats: 2.4 s at 100 Hz, 0.48 s at 500 Hz.
PAIRED_WITHIN_S: Final = 1.0
#: Messages kept: SYNC counters repeat, so older cycles would be ambiguous.
REMEMBERED: Final = SYNC_OVERFLOW
#: There is contact if the largest true force is at least this part of the range: twice the sensor noise.
CONTACT_RATIO: Final = 0.1

#: From the end of a frame to its image at a client: gateway, fabric and solver, the median of a running stepped skin
#: (`skin bench chain`: 1.6 to 1.8 ms, of which the solver takes 0.06 ms).
LATENESS_NS: Final = 1_800_000
#: An image is on show until the next, at most for this time; then the reconstructor has stopped.
SHOWN_NS: Final = 500_000_000
#: Most images that are kept until the truth of their time comes, and most truths.
IMAGES_KEPT: Final = 512
TRUTHS_KEPT: Final = 64
#: A truth stands for this time to each side; one comes each 10 ms or more often.
NEAR_NS: Final = 10_000_000

Made = TypeVar("Made", CycleMeasurement, Image, Label)


class Pairing(Generic[Made]):
    """Pairs of truth and image or label of one cycle.

    Messages come in any order; each pair is returned once.

    Parameters
    ----------
    period_s : float
        Period of SYNC. Nodes read no counter in a SYNC without one; the time of SYNC then tells the cycle.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._truths: deque[Truth] = deque(maxlen=REMEMBERED)
        self._waiting: deque[Made] = deque(maxlen=REMEMBERED)

    def take_truth(self, truth: Truth) -> list[tuple[Made, Truth]]:
        """Keep `truth`; return its pair with the waiting message of its cycle, if any."""
        self._truths.append(truth)
        message = next((each for each in reversed(self._waiting) if of_one_cycle(each, truth, self._period_s)), None)
        if message is None:
            return []
        self._waiting.remove(message)
        return [(message, truth)]

    def take(self, message: Made) -> list[tuple[Made, Truth]]:
        """Return the pair of the message and its cycle's truth, or keep the message until this truth comes."""
        truth = self.truth_of(message)
        if truth is None:
            self._waiting.append(message)
            return []
        return [(message, truth)]

    def truth_of(self, message: Made) -> Truth | None:
        """Return the truth to be shown beside a message, that of its cycle; None if it has not come."""
        found = (truth for truth in reversed(self._truths) if of_one_cycle(message, truth, self._period_s))
        return next(found, None)


class ShownImages:
    """Sums of no single instant: pairs of a truth and the image that was on show at its instant.

    An image is on show from `Image.published_mono_ns` until the next, for `SHOWN_NS` at most. So all moments weigh
    alike, however many images there are of each.
    """

    def __init__(self) -> None:
        self._images: deque[Image] = deque(maxlen=IMAGES_KEPT)
        self._waiting: deque[Truth] = deque(maxlen=TRUTHS_KEPT)
        self._truths: deque[Truth] = deque(maxlen=TRUTHS_KEPT)

    def take_truth(self, truth: Truth) -> list[tuple[Image, Truth]]:
        """Keep `truth`; return its pair if a later image shows which one was on show."""
        self._truths.append(truth)
        self._waiting.append(truth)
        return self._pairs()

    def take(self, image: Image) -> list[tuple[Image, Truth]]:
        """Keep `image`; return the pairs of all truths before it."""
        self._images.append(image)
        return self._pairs()

    def truth_of(self, image: Image) -> Truth | None:
        """Return the truth nearest to the image's publication, None if there is none within twice `NEAR_NS`.

        The truth of just before is shown until that of the image has come.
        """
        return _nearest(self._truths, image.published_mono_ns, 2 * NEAR_NS)

    def _pairs(self) -> list[tuple[Image, Truth]]:
        found = []
        while self._waiting and self._images and self._images[-1].published_mono_ns > self._waiting[0].sampled_mono_ns:
            truth = self._waiting.popleft()
            while len(self._images) > 1 and self._images[1].published_mono_ns <= truth.sampled_mono_ns:
                self._images.popleft()
            if 0 <= truth.sampled_mono_ns - self._images[0].published_mono_ns <= SHOWN_NS:
                found.append((self._images[0], truth))
        return found


class NearestTruths:
    """Sending steps: pairs of a label and the truth nearest to `Label.sampled_mono_ns`."""

    def __init__(self) -> None:
        self._truths: deque[Truth] = deque(maxlen=TRUTHS_KEPT)
        self._waiting: deque[Label] = deque(maxlen=TRUTHS_KEPT)

    def take_truth(self, truth: Truth) -> list[tuple[Label, Truth]]:
        """Keep `truth`; return the pairs of all labels before it."""
        self._truths.append(truth)
        return self._pairs()

    def take(self, label: Label) -> list[tuple[Label, Truth]]:
        """Return the pair of the label, or keep the label until a later truth comes."""
        self._waiting.append(label)
        return self._pairs()

    def truth_of(self, label: Label) -> Truth | None:
        """Return the truth nearest to the label's sums, None if there is none within `NEAR_NS`."""
        return _nearest(self._truths, label.sampled_mono_ns)

    def _pairs(self) -> list[tuple[Label, Truth]]:
        found = []
        while self._waiting and self._truths and self._truths[-1].sampled_mono_ns >= self._waiting[0].sampled_mono_ns:
            label = self._waiting.popleft()
            truth = self.truth_of(label)
            if truth is not None:
                found.append((label, truth))
        return found


def of_one_cycle(message: CycleMeasurement | Image | Label, truth: Truth, period_s: float) -> bool:
    """Tell whether a message and a truth belong to the same SYNC: by its counter, or by its time if nodes read none."""
    later_s = (truth.sampled_mono_ns - message.sampled_mono_ns) * 1e-9
    if truth.sync_counter:
        within_s = min(PAIRED_WITHIN_S, SYNC_OVERFLOW / 2 * period_s)
        return truth.sync_counter == message.sync_counter and abs(later_s) < within_s
    # The nodes of one bus received SYNC before the mean over the buses, or after.
    return -period_s / 2 <= later_s < period_s / 2


ImagePairs = Pairing[Image] | ShownImages
LabelPairs = Pairing[Label] | NearestTruths


def image_pairs(layout: Layout) -> ImagePairs:
    """Return what finds the pairs of images and truths of a skin."""
    return Pairing(layout.sync.period_s) if layout.is_of_one_instant else ShownImages()


def label_pairs(layout: Layout) -> LabelPairs:
    """Return what finds the pairs of labels and truths of a skin."""
    return Pairing(layout.sync.period_s) if layout.sends.in_cycles else NearestTruths()


def in_contact(true: npt.NDArray[np.float32], peak_n: float) -> bool:
    """Tell whether forces are a contact: largest true force >= `CONTACT_RATIO` x `peak_n`."""
    return float(true.max()) >= CONTACT_RATIO * peak_n


def _nearest(truths: deque[Truth], time_ns: int, within_ns: int = NEAR_NS) -> Truth | None:
    """Return the truth nearest to a time, None if there is none within `within_ns`."""
    found = min(truths, key=lambda truth: abs(truth.sampled_mono_ns - time_ns), default=None)
    return found if found is not None and abs(found.sampled_mono_ns - time_ns) <= within_ns else None
