"""The figures of a run: a value for programs, and rows of words for a person."""

from typing import Final

import msgspec

#: Nodes the rows name when frames are missing.
NAMED: Final = 5


class NodeMissing(msgspec.Struct, frozen=True, kw_only=True):
    """A node whose frames missed their cycle.

    Attributes
    ----------
    missing, late : int
        Frames that a cycle had to do without, and that came too late for theirs.
    emcy : str
        Error code of the node's newest emergency (CiA 301, 7.2.7.1), ``0000h`` for none.
    """

    bus: str
    node: int
    missing: int
    late: int
    emcy: str


class Percentiles(msgspec.Struct, frozen=True, kw_only=True):
    """The median and the 99th percentile; None where nothing was measured."""

    p50: float | None
    p99: float | None


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """The figures of a run; None where nothing was measured.

    Attributes
    ----------
    frames_sent, frames_received, frames_lost : int
        TPDOs with sums; lost are those that were sent and not received.
    frames_dropped : int
        TPDOs that their nodes gave up before they reached the bus.
    frames_missing, frames_late : int
        TPDOs that a cycle had to do without, and those that came too late for theirs.
    nodes_missing : list of NodeMissing
        The worst nodes first.
    psnr_sensor_db, psnr_image_db : float or None
        Against the true force, means over contact cycles.
    sensor_adds_noise : bool or None
        False when the sensor only rounds to its ADC's steps, as with a recording.
    label_accuracy : float or None
        Part of the contact cycles with a named object that got the right label.
    latency_ms : Percentiles
        SYNC to published image.
    bus_load : list of float
        Per bus, since SYNC started, exact stuffing.
    picture : str
        Path of the picture; absent when there was no contact to show, or it could not be written.
    """

    cycles: int
    cycles_complete: int
    frames_sent: int
    frames_received: int
    frames_lost: int
    frames_dropped: int
    frames_missing: int
    frames_late: int
    nodes_missing: list[NodeMissing]
    psnr_sensor_db: float | None
    psnr_image_db: float | None
    sensor_adds_noise: bool | None
    contact_cycles: int
    label_accuracy: float | None
    latency_ms: Percentiles
    sync_rate_hz: float
    bus_load: list[float]
    picture: str | msgspec.UnsetType = msgspec.UNSET

    @property
    def failure(self) -> str:
        """Why the run measured nothing; empty when it did."""
        if not self.cycles:
            return "no cycle: SYNC never came"
        if self.cycles_complete:
            return ""
        because = ""
        if self.frames_dropped:
            because = f": nodes gave up {self.frames_dropped} TPDOs that did not get on the bus in time"
        return f"no cycle was complete{because}; 'skin plan' says what a layout does to its buses"

    def rows(self) -> list[tuple[str, str]]:
        """Return the figures in words, each with its name."""
        complete = f"{self.cycles_complete} of {self.cycles} complete, at {self.sync_rate_hz:.1f} Hz"
        frames = f"{self.frames_sent} sent, {self.frames_received} received, {self.frames_lost} lost"
        rows = [("cycles", complete), ("frames", frames)]
        if self.frames_missing:
            late = f"{self.frames_dropped} given up by their nodes, {self.frames_late} late"
            rows.append(("missing", f"{self.frames_missing} frames missed their cycle: {late}"))
            worst = (f"{each.bus}:{each.node} ({each.missing})" for each in self.nodes_missing[:NAMED])
            rows.append(("missing most", f"node {', '.join(worst)}"))
        rows.append(("bus load", ", ".join(f"{load:.1%}" for load in self.bus_load)))
        latency = self.latency_ms
        if latency.p50 is not None and latency.p99 is not None:
            rows.append(("SYNC to image", f"{latency.p50:.1f} ms, 99 % within {latency.p99:.1f} ms"))
        if self.psnr_image_db is not None:
            sensor = f"the sensor's {self.psnr_sensor_db:.1f} dB"
            against = sensor if self.sensor_adds_noise else "what was played, which has no noise"
            over = f"over {self.contact_cycles} contact cycles"
            rows.append(("image", f"{self.psnr_image_db:.1f} dB, against {against}, {over}"))
        if self.label_accuracy is not None:
            rows.append(("label", f"right on {self.label_accuracy:.1%} of the contact cycles"))
        if self.picture:
            rows.append(("picture", self.picture))
        return rows
