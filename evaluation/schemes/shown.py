"""What every scheme gives: frames, latencies, images; and the figures of them."""

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from evaluation.result import Row
from evaluation.schemes.judge import Images, Updates, quality
from evaluation.schemes.scenes import Scene, Touch
from evaluation.schemes.wire import Nanoseconds, Sent
from skin.errors import InputError

#: What a receiver does: shows what came; or solves as our service does, without or with the sensor's noise known.
Receiver = Literal["plain", "solved", "noise known"]
Family = Literal["sums", "scan", "coarse", "events"]


@dataclass(frozen=True, eq=False)
class Shown:
    """What a scheme sent of a touch, and what its receiver had in use.

    Attributes
    ----------
    sent : Sent
        All frames.
    latency_ns : array of int64, shape (values,)
        From the sample to the end of the frame that brings it.
    images : Images or Updates
        What is in use.
    rate_hz : float, optional
        How often all is sent; None for what goes by events.
    """

    sent: Sent
    latency_ns: Nanoseconds
    images: Images | Updates
    rate_hz: float | None

    def figures(self, what: Scene) -> Row:
        """Return bits, loads, latencies in ms, and `evaluation.schemes.judge.quality` against the touch's truth."""
        late = {
            "latency_p99_ms": float(np.percentile(self.latency_ns, 99)) * 1e-6 if len(self.latency_ns) else 0.0,
            "latency_worst_ms": float(self.latency_ns.max()) * 1e-6 if len(self.latency_ns) else 0.0,
        }
        return self.sent.traffic() | late | quality(what.true_n, self.images) | {"rate_hz": self.rate_hz}


class Scheme(Protocol):
    """A way to acquire a touch."""

    @property
    def receiver(self) -> Receiver:
        """What becomes of what it sends."""

    @property
    def name(self) -> str:
        """What it is called in a table."""

    @property
    def family(self) -> Family:
        """What it is one form of."""

    def show(self, touch: Touch, share: float) -> Shown:
        """Measure `touch` with `share` of the default skin's bits a second; events take what they take."""


def check_receiver(receiver: Receiver, known: tuple[Receiver, ...]) -> None:
    """Raise InputError unless `receiver` is one of `known`."""
    if receiver not in known:
        raise InputError(f"expected a receiver of {' or '.join(known)}, got '{receiver}'")
