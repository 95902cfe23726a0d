"""The recorded images or labels of a run, and which measurements they belong to."""

from typing import Final, Generic, TypeVar

import numpy as np

from canskin.messages import Image, Label, Measurement

#: Most images and labels that wait for their measurements.
_MOST_KEPT: Final = 10_000

#: Images whose forces differ by less than this part of the range are equal: solvers begin with the image before, so
#: rounding depends on the images since the reconstructor's start. A converter of 10 bits has steps of 0.001.
PIXEL_ERROR: Final = 5e-5

_Answer = TypeVar("_Answer", Image, Label)


def same_pixels(made: bytes, recorded: bytes, force_max_n: float) -> bool:
    """Tell whether two images, float32, newtons, are equal but for rounding."""
    return made == recorded or largest_difference_n(made, recorded) < PIXEL_ERROR * force_max_n


def largest_difference_n(made: bytes, recorded: bytes) -> float:
    """Return the largest difference of two images, float32, newtons; infinite if their sizes differ."""
    if len(made) != len(recorded):
        return float("inf")
    return float(np.abs(np.frombuffer(made, "<f4") - np.frombuffer(recorded, "<f4")).max())


class Answers(Generic[_Answer]):
    """The recorded images or labels, until their measurements are played.

    A measurement without an answer was not used live, or its answer was lost on the way to the recorder. The numbers of
    the answers before and after it tell which; of several measurements the first count as used.
    """

    def __init__(self, near_ns: int, *, is_followed: bool) -> None:
        self._near_ns = near_ns
        self._is_followed = is_followed
        self._kept: dict[int, _Answer] = {}
        self._newest_ns = self._number = 0

    def keep(self, answer: _Answer) -> None:
        """Keep an answer; the oldest, whose measurements are missing, go."""
        self._kept[answer.cycle] = answer
        self._newest_ns = answer.sampled_mono_ns
        if len(self._kept) > _MOST_KEPT:
            del self._kept[next(iter(self._kept))]

    def reaches(self, sync_ns: int) -> bool:
        """Tell whether the answer to a measurement, or a later answer, has come."""
        return not self._is_followed or self._newest_ns >= sync_ns

    def of(self, measurement: Measurement) -> tuple[_Answer | None, bool]:
        """Return the answer to the next measurement, if it was recorded, and whether there was one live."""
        sync_ns = measurement.sampled_mono_ns
        answer = self._kept.get(measurement.cycle)
        if answer is not None and abs(answer.sampled_mono_ns - sync_ns) < self._near_ns:
            del self._kept[measurement.cycle]
            self._number = answer.number
            return answer, True
        if not self._is_followed:
            return None, True
        later = (each for each in self._kept.values() if each.sampled_mono_ns > sync_ns)
        following = min(later, key=lambda each: each.sampled_mono_ns, default=None)
        if following is None or following.number <= self._number + 1:
            return None, False
        self._number += 1
        return None, True
