"""The figures of a run, as a value for programs and as rows of a table."""

from typing import Final, NamedTuple

import msgspec

from canskin.peers import ORDINARY

#: Part of the cores above which a chain has too little of them.
FULL_RATIO: Final = 0.85
#: Most nodes that the table names when frames are missing.
NAMED: Final = 5


class _Words(NamedTuple):
    """How a run is told; the templates take `cycles`, `complete`, `at` and `because`."""

    newest: str
    nothing: str
    incomplete: str
    counts: tuple[str, str]
    latency: str
    moments: str


#: By the way of sending.
WORDS: Final = {
    "synchronous": _Words(
        "cycle {cycles}, {complete} complete",
        "no cycle: SYNC never came",
        "no cycle was complete{because}; 'skin plan' says what a layout does to its buses",
        ("cycles", "{complete} of {cycles} complete{at}"),
        "SYNC to image",
        "contact cycles",
    ),
    "steps": _Words(
        "measurement {cycles}, {complete} with all blocks valid",
        "no measurement: no sums came",
        "no measurement had all blocks valid: the nodes' states are on the page and in the gateway's log",
        ("measurements", "{cycles} published, {complete} with all blocks valid"),
        "frame to image",
        "moments of contact",
    ),
}


class NodeMissing(msgspec.Struct, frozen=True, kw_only=True):
    """A node whose frames missed their cycle.

    Attributes
    ----------
    missing, late : int
        Number of frames that did not come in their cycle, and that came too late.
    emcy : str
        Error code of the node's newest emergency (CiA 301, 7.2.7.1), ``0000h`` for none.
    """

    bus: str
    node: int
    missing: int
    late: int
    emcy: str


class Percentiles(msgspec.Struct, frozen=True, kw_only=True):
    """Median and 99th percentile; None without measurement."""

    p50: float | None
    p99: float | None


class Report(msgspec.Struct, frozen=True, kw_only=True):
    """The figures of a run; None without measurement.

    Attributes
    ----------
    sending : str
        ``synchronous`` or ``steps``.
    cycles, cycles_complete : int
        Cycles that have ended, and cycles in which every block was valid; stepped: measurements published, and those
        in which every block was valid.
    frames_sent, frames_received, frames_lost : int
        TPDOs with sums; lost = sent, but not received.
    frames_dropped : int
        TPDOs that their nodes dropped before transmission.
    frames_missing, frames_late : int
        TPDOs that did not come in their cycle, and TPDOs that came too late.
    nodes_missing : list of NodeMissing
        The worst nodes first.
    psnr_sensor_db, psnr_image_db : float or None
        PSNR of one raw sample of the sensor and of the image against the true force, means over cycles with contact.
    sensor_adds_noise : bool or None
        False when the sensor only rounds to ADC counts, as with a recording.
    label_accuracy : float or None
        Cycles with the right label / cycles with contact and a named object; None without any label.
    labelled_ratio : float or None
        Cycles with a label, right or wrong / cycles with contact and a named object. "No contact" is a label.
    contact_cycles : int
        Cycles with contact; stepped: true forces with contact, 100 a second.
    latency_ms : Percentiles
        Time from SYNC to the published image; stepped: from the end of the newest frame that is in the image. The
        sample of that frame is older by `sample_age_ms`.
    sample_age_ms : float or None
        Stepped: age of the samples of these frames at the ends of the frames, by their slots; 99 % are not older. None
        with synchronous sending.
    bus_load : list of float
        Load of each bus since SYNC started, exact stuffing.
    kbit_per_s : float or None
        Bits of all buses, from their loads; None with CAN FD.
    cpu_ratio : dict of str to float
        Processor time, user and system, of each process / wall time; one processor is 1. Empty where the system does
        not tell.
    cores : int
        Of the machine.
    scheduling : str
        Of the demo's process at the end, see `canskin.peers.Peer`; empty where it did not ask.
    doubtful_taxels : int
        Taxels in doubt at the end: their force may be an error of the zero (`docs/calibration.md`).
    picture : str
        Path of the picture; absent without contact, or if the file could not be written.
    """

    sending: str = "synchronous"
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
    labelled_ratio: float | None = None
    latency_ms: Percentiles
    sample_age_ms: float | None = None
    sync_rate_hz: float
    bus_load: list[float]
    kbit_per_s: float | None = None
    cpu_ratio: dict[str, float] = {}
    cores: int = 0
    scheduling: str = ""
    doubtful_taxels: int = 0
    picture: str | msgspec.UnsetType = msgspec.UNSET

    @property
    def failure(self) -> str:
        """Why the run measured nothing; empty if it did measure."""
        words = WORDS[self.sending]
        if not self.cycles or self.cycles_complete:
            return "" if self.cycles else words.nothing
        because = f": nodes gave up {self.frames_dropped} TPDOs that did not get on the bus in time"
        return words.incomplete.format(because=because if self.frames_dropped else "")

    @property
    def likely_cause(self) -> str:
        """What this machine lacks that may explain incomplete cycles; empty if it lacks nothing known."""
        used = sum(self.cpu_ratio.values())
        if self.cores and used > FULL_RATIO * self.cores:
            return f"no processor is left: the chain takes {used:.1f} of {self.cores} cores"
        if self.scheduling == ORDINARY:
            return "no real-time priority, so other programs delay the nodes: 'skin doctor time' says what gives it"
        return ""

    def rows(self) -> list[tuple[str, str]]:
        """Return the rows of the table: name and text of each figure."""
        words = WORDS[self.sending]
        name, counts = words.counts
        at = f", at {self.sync_rate_hz:.1f} Hz" if self.sync_rate_hz else ""
        counted = counts.format(cycles=self.cycles, complete=self.cycles_complete, at=at)
        frames = f"{self.frames_sent} sent, {self.frames_received} received, {self.frames_lost} lost"
        rows = [(name, counted), ("frames", frames), *self._rows_of_missing()]
        bits = f"; {self.kbit_per_s:.0f} kbit/s on all" if self.kbit_per_s is not None else ""
        rows.append(("bus load", ", ".join(f"{load:.1%}" for load in self.bus_load) + bits))
        latency = self.latency_ms
        if latency.p50 is not None and latency.p99 is not None:
            within = f"{latency.p50:.1f} ms, 99 % within {latency.p99:.1f} ms"
            if self.sample_age_ms is not None:
                within += f"; 99 % of samples are up to {self.sample_age_ms:.1f} ms older than their frames"
            rows.append((words.latency, within))
        if self.psnr_image_db is not None:
            sensor = f"one raw sample's {self.psnr_sensor_db:.1f} dB"
            against = sensor if self.sensor_adds_noise else "what was played, which has no noise"
            over = f"over {self.contact_cycles} {words.moments}"
            rows.append(("image", f"{self.psnr_image_db:.1f} dB, against {against}, {over}"))
        if self.label_accuracy is not None:
            came = f"; {self.labelled_ratio:.1%} got a label" if self.labelled_ratio is not None else ""
            rows.append(("label", f"right on {self.label_accuracy:.1%} of the {words.moments}{came}"))
        elif self.labelled_ratio == 0:
            why = ": no classifier ran" if self.cpu_ratio and "classifier" not in self.cpu_ratio else ""
            rows.append(("label", f"no label came{why}"))
        if self.doubtful_taxels:
            why = (
                "a still force, a zero that has risen, or gains of another master: 'skin tare' or 'skin tare --region'"
            )
            rows.append(("in doubt", f"{self.doubtful_taxels} taxels at the end: {why}"))
        if self.cpu_ratio:
            each = ", ".join(f"{name} {ratio:.0%}" for name, ratio in self.cpu_ratio.items())
            rows.append(("processors", f"{each}; all {sum(self.cpu_ratio.values()):.0%} of one"))
        if self.picture:
            rows.append(("picture", self.picture))
        return rows

    def _rows_of_missing(self) -> list[tuple[str, str]]:
        if not self.frames_missing:
            return []
        late = f"{self.frames_dropped} given up by their nodes, {self.frames_late} late"
        worst = (f"{each.bus}:{each.node} ({each.missing})" for each in self.nodes_missing[:NAMED])
        rows = [
            ("missing", f"{self.frames_missing} frames missed their cycle: {late}"),
            ("missing most", f"node {', '.join(worst)}"),
        ]
        return [*rows, ("likely cause", self.likely_cause)] if self.likely_cause else rows
