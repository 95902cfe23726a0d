"""Sums of nodes with two states: a cycle is one of recognition or one of images, by the state that its SYNC asks for.

The frames of the two states have identifiers of their own, so a frame tells by its identifier what it carries.
"""

from collections.abc import Collection, Mapping

import msgspec

from canskin.messages import FrameCounts, Measurement
from dbc.contract import Contract, NodeContract
from dbc.dictionary import SkinState
from dbc.frame import Frames
from gateway.cycle_gathering import CycleGathering
from gateway.gathering import Health, Sync
from gateway.nmt_master import NmtMaster


class StateGathering:
    """Gathers the cycles of both states; the measurements of each have the fingerprint of its Φ.

    Parameters
    ----------
    contract : Contract
        With recognition.
    early_echoes : collection of int
        See `gateway.collector.Collector`.
    """

    #: See `gateway.cycle_gathering.CycleGathering`.
    may_sleep_until_s = float("-inf")
    replay_step_ns = None
    disturbance = CycleGathering.disturbance

    def __init__(self, contract: Contract, early_echoes: Collection[int] = ()) -> None:
        images, recognition = (CycleGathering(state, early_echoes) for state in contract.states)
        self.of_state = {SkinState.RECOGNITION: recognition, SkinState.IMAGES: images}
        self._both = images, recognition

    @property
    def published(self) -> int:
        """Number of measurements so far."""
        return sum(each.published for each in self._both)

    @property
    def complete(self) -> int:
        """Number of measurements in which every block that sends sums was valid."""
        return sum(each.complete for each in self._both)

    @property
    def counts(self) -> FrameCounts:
        """What became of the frames; those of the other state are not foreign."""
        images, few = (each.counts for each in self._both)
        names = [name for name in msgspec.structs.asdict(images) if name != "foreign"]
        total = FrameCounts(**{name: getattr(images, name) + getattr(few, name) for name in names})
        total.foreign = images.foreign - few.received
        return total

    @property
    def in_flight(self) -> int:
        """Number of open cycles."""
        return sum(each.in_flight for each in self._both)

    @property
    def due_s(self) -> float:
        """When the oldest cycle must be closed."""
        return min(each.due_s for each in self._both)

    def trust(self, node: NodeContract, *, proven: bool) -> None:
        """Use the sums of a node from the next cycle on if `proven`; else stop at once."""
        for each in self._both:
            each.trust(node, proven=proven)

    def take(self, bus: int, arrived: Frames, health: Health, now_s: float) -> None:
        """Use the frames that arrived on a bus, in bus order."""
        for each in self._both:
            each.take(bus, arrived, health, now_s)

    def begin(self, sync: Sync) -> list[Measurement]:
        """Open the cycle of a SYNC in its state; return the measurements of cycles that were closed for it."""
        asked = self.of_state[sync.state]
        (other,) = (each for each in self._both if each is not asked)
        return asked.begin(sync) + other.begin(sync, asked)

    def tick(self, now_s: float) -> None:
        """Do nothing: cycles end by frames and time alone."""

    def measurements(self, now_s: float, wall_offset_ns: int) -> list[Measurement]:
        """End the cycles that are settled or out of time; return their measurements, by their number."""
        made = [measurement for each in self._both for measurement in each.measurements(now_s, wall_offset_ns)]
        return sorted(made, key=lambda measurement: measurement.cycle)

    def look(self, masters: Mapping[int, NmtMaster]) -> None:
        """Let cycles wait for operational nodes only."""
        for each in self._both:
            each.look(masters)

    def take_foreign_syncs(self, bus: int) -> int:
        """Return the number of foreign SYNCs on a bus since the last call."""
        return max(each.take_foreign_syncs(bus) for each in self._both)

    def missing_and_late(self, place: int) -> tuple[int, int]:
        """Return how many frames of the node at `place` did not come in their cycle, and came too late."""
        (missing, late), (few_missing, few_late) = (each.missing_and_late(place) for each in self._both)
        return missing + few_missing, late + few_late
