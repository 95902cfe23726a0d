"""The offsets of a recorded run, for its cycles that are decoded again."""

from bisect import bisect_right
from pathlib import Path

import msgspec

from canskin.messages import MEASUREMENT, Measurement
from recording.mcap_file import read_messages, wall_offset_ns
from skin.layout import Layout
from skin.measured_sums import check_measurement


class RecordedOffsets:
    """Puts into each measurement what the live gateway put into that of the same cycle.

    Parameters
    ----------
    path : pathlib.Path
        Recording.

    Attributes
    ----------
    applied : int
        Measurements so far that have got offsets.
    """

    def __init__(self, path: Path, layout: Layout) -> None:
        self.applied = 0
        #: Beginning of each cycle with other offsets, half a period before its SYNC, and what is used from there on.
        self._from_ns: list[int] = []
        self._used: list[tuple[bytes, bytes]] = []
        phi, offset_ns = layout.phi(), wall_offset_ns(path)
        early_ns = round(layout.sync.period_s * 1e9 / 2)
        for read in read_messages(path, [MEASUREMENT], lambda _: None):
            recorded = check_measurement(read.message, phi, Measurement)
            used = recorded.offsets, recorded.usable
            if used != (self._used[-1] if self._used else (b"", b"")):
                self._from_ns.append(recorded.sampled_mono_ns + offset_ns - early_ns)
                self._used.append(used)

    @property
    def is_empty(self) -> bool:
        """Whether the run had no offsets."""
        return not self._used

    def apply(self, measurement: Measurement) -> Measurement:
        """Return a measurement, whose sampling instant is on the wall clock, with the offsets of its instant."""
        place = bisect_right(self._from_ns, measurement.sampled_mono_ns) - 1
        if place < 0:
            return measurement
        offsets, usable = self._used[place]
        self.applied += bool(offsets)
        return msgspec.structs.replace(measurement, offsets=offsets, usable=usable)

    def take(self, measurement: Measurement) -> None:
        """Learn nothing."""

    def work(self) -> None:
        """Learn nothing."""
