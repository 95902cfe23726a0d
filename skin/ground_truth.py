"""The ground truth of a cycle: pairs of truth and image or label, and the test for contact."""

from typing import Final, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from skin.messages import Image, Label, Truth

#: Messages with equal SYNC counters belong to one cycle if their SYNCs are nearer than this: the counter repeats, after
#: 2.4 s at 100 Hz.
PAIRED_WITHIN_NS: Final = 1_000_000_000
#: Messages kept: SYNC counters run from 1 to 240 (CiA 301, 7.2.5.1), so older cycles would be ambiguous.
REMEMBERED: Final = 240
#: A cycle has contact if the largest true force is at least this part of the range: twice the sensor noise.
CONTACT_RATIO: Final = 0.1

Made = TypeVar("Made", Image, Label)
Kept = TypeVar("Kept", Image, Label, Truth)


class Pairing(Generic[Made]):
    """Pairs of truth and image or label of one cycle; messages come in any order, each pair is returned once."""

    def __init__(self) -> None:
        self._truths: dict[int, Truth] = {}
        self._waiting: dict[int, Made] = {}

    def take_truth(self, truth: Truth) -> Made | None:
        """Keep `truth`; return the waiting message of its cycle, if any."""
        _remember(self._truths, truth)
        message = self._waiting.get(truth.sync_counter)
        if message is None or not _near(message, truth):
            return None
        return self._waiting.pop(truth.sync_counter)

    def take(self, message: Made) -> Truth | None:
        """Return the truth of the message's cycle, or keep the message until this truth comes."""
        truth = self.truth_of(message)
        if truth is None:
            _remember(self._waiting, message)
        return truth

    def truth_of(self, message: Made) -> Truth | None:
        """Return the truth of the message's cycle, None if it has not come."""
        truth = self._truths.get(message.sync_counter)
        return truth if truth is not None and _near(message, truth) else None


def in_contact(true: npt.NDArray[np.float32], peak_n: float) -> bool:
    """Tell whether a cycle has contact: largest true force >= `CONTACT_RATIO` x `peak_n`."""
    return float(true.max()) >= CONTACT_RATIO * peak_n


def _near(message: Image | Label, truth: Truth) -> bool:
    return abs(message.sync_mono_ns - truth.sync_mono_ns) < PAIRED_WITHIN_NS


def _remember(kept: dict[int, Kept], message: Kept) -> None:
    """Keep the newest `REMEMBERED` messages, by counter."""
    kept.pop(message.sync_counter, None)
    kept[message.sync_counter] = message
    while len(kept) > REMEMBERED:
        del kept[next(iter(kept))]
