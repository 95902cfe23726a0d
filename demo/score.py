"""The figures of a run: messages in, a `demo.report.Report` out.

PSNR follows the paper's equation with the skin's largest force as peak, for each truth with contact, of the image that
`skin.ground_truth.image_pairs` finds: of the truth's cycle, or on show at its instant where sums are of no single one.
"""

import os
import threading
from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from canskin.messages import (
    GATEWAY,
    IMAGE,
    LABEL,
    NODES,
    TRUTH,
    UNKNOWN_ERROR_NS,
    GatewayStatus,
    Image,
    Label,
    NodesStatus,
    Topic,
    Truth,
)
from demo.report import NodeMissing, Percentiles, Report
from skin.ground_truth import ImagePairs, LabelPairs, image_pairs, in_contact, label_pairs
from skin.layout import Layout
from skin.psnr import adds_noise, psnr_db

#: Most nodes in a report when frames are missing.
NODES_NAMED: Final = 16
#: Number of cycles whose figures are kept: an hour at 100 Hz.
HISTORY: Final = 360_000
#: The picture shows the last cycle whose largest force is at least this part of the largest force of the run.
FULL_CONTACT_RATIO: Final = 0.95


@dataclass(frozen=True)
class CycleImages:
    """The images of one cycle, newtons, shape (rows, columns)."""

    true: npt.NDArray[np.float32]
    sensor: npt.NDArray[np.float32]
    image: npt.NDArray[np.float32]


def _newest() -> deque[float]:
    return deque(maxlen=HISTORY)


@dataclass
class Score:
    """Collects the messages of a run; the handlers may be called from several threads.

    Attributes
    ----------
    psnr_image_db, psnr_sensor_db : deque of float
        One entry per contact cycle, of the last `HISTORY`.
    latency_ms : deque of float
        Time from SYNC to the published image, one entry per image with new sums, of the last `HISTORY`. Stepped: from
        the end of the newest frame that is in the image.
    sample_age_ms : deque of float
        Stepped: how much older than its end the sample of that frame is at most, of the last `HISTORY`.
    named_contacts : int
        Truths with contact and a named object.
    labelled, labelled_right : int
        Labels at such truths, and right labels.
    cpu_ratio : dict of str to float
        Processor time / wall time of each process; set by the run.
    scheduling : str
        Of the demo's process; set by the run.
    """

    #: What a score takes, and by which method.
    topics: ClassVar[tuple[tuple[Topic, str], ...]] = (
        (GATEWAY, "take_gateway"),
        (NODES, "take_nodes"),
        (TRUTH, "take_truth"),
        (IMAGE, "take_image"),
        (LABEL, "take_label"),
    )
    layout: Layout
    gateway: GatewayStatus | None = None
    nodes: dict[str, NodesStatus] = field(default_factory=dict)
    psnr_image_db: deque[float] = field(default_factory=_newest)
    psnr_sensor_db: deque[float] = field(default_factory=_newest)
    latency_ms: deque[float] = field(default_factory=_newest)
    sample_age_ms: deque[float] = field(default_factory=_newest)
    contact_cycles: int = 0
    named_contacts: int = 0
    labelled: int = 0
    labelled_right: int = 0
    snapshot: CycleImages | None = None
    last_label: Label | None = None
    cpu_ratio: dict[str, float] = field(default_factory=dict)
    scheduling: str = ""
    _images: ImagePairs = field(init=False)
    _labels: LabelPairs = field(init=False)
    _peak_n: float = 0.0
    _newest_ns: int = -1
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        self._images, self._labels = image_pairs(self.layout), label_pairs(self.layout)

    def take_gateway(self, status: GatewayStatus) -> None:
        """Keep the newest counters of the gateway."""
        self.gateway = status

    def take_nodes(self, status: NodesStatus) -> None:
        """Keep the newest counters of each process of nodes."""
        self.nodes[status.process] = status

    def take_truth(self, truth: Truth) -> None:
        """Use the true forces of a cycle; a truth of another size is ignored."""
        if {len(truth.true), len(truth.sensor)} != {4 * self.layout.taxels.count}:
            return
        with self._lock:
            if self._is_named_contact(truth):
                self.named_contacts += 1
            for image, true in self._images.take_truth(truth):
                self._compare(image, true)
            for label, true in self._labels.take_truth(truth):
                self._count_label(label, true)

    def take_image(self, image: Image) -> None:
        """Compare an image with the truth of its cycle; an image of another size is ignored."""
        if len(image.pixels) != 4 * self.layout.taxels.count:
            return
        with self._lock:
            # An image without any new sum, of a skin with nothing to send, has no latency.
            if image.valid_sums and image.sampled_mono_ns != self._newest_ns:
                self.latency_ms.append((image.published_mono_ns - image.sampled_mono_ns) * 1e-6)
                if not self.layout.sends.in_cycles and image.sampled_error_ns != UNKNOWN_ERROR_NS:
                    self.sample_age_ms.append(image.sampled_error_ns * 1e-6)
            self._newest_ns = image.sampled_mono_ns
            for shown, truth in self._images.take(image):
                self._compare(shown, truth)

    def take_label(self, label: Label) -> None:
        """Compare a label with the object that touched in its cycle."""
        self.last_label = label
        with self._lock:
            for said, truth in self._labels.take(label):
                self._count_label(said, truth)

    def label_text(self) -> str:
        """Return the newest label as text."""
        if self.last_label is None:
            return "no label"
        if not self.last_label.is_measured(self.layout.measurement.sums):
            return "not measured"
        return self.last_label.label or "no contact"

    def _nodes_missing(self) -> list[NodeMissing]:
        """Return the nodes whose frames missed their cycle, the worst first."""
        rows = [
            NodeMissing(bus=bus.name, node=node_id, missing=missing, late=late, emcy=f"{emcy:04X}h")
            for bus in (self.gateway.buses if self.gateway else [])
            for node_id, missing, late, emcy in zip(bus.nodes, bus.missing, bus.late, bus.emcy, strict=False)
            if missing or late
        ]
        return sorted(rows, key=lambda row: -row.missing)[:NODES_NAMED]

    def _count_label(self, label: Label, truth: Truth) -> None:
        if self._is_named_contact(truth):
            self.labelled += 1
            self.labelled_right += label.label == truth.label

    def _is_named_contact(self, truth: Truth) -> bool:
        return bool(truth.label) and in_contact(self._grid(truth.true), self.layout.taxels.force_max_n)

    def _compare(self, image: Image, truth: Truth) -> None:
        true = self._grid(truth.true)
        if not in_contact(true, self.layout.taxels.force_max_n):
            return
        sensor, image_n = self._grid(truth.sensor), self._grid(image.pixels)
        taxels = self.layout.taxels
        there_n = taxels.without_gaps(true)
        self.psnr_sensor_db.append(psnr_db(there_n, taxels.without_gaps(sensor), taxels.force_max_n))
        self.psnr_image_db.append(psnr_db(there_n, taxels.without_gaps(image_n), taxels.force_max_n))
        self.contact_cycles += 1
        peak_n = float(true.max())
        self._peak_n = max(self._peak_n, peak_n)
        if peak_n >= FULL_CONTACT_RATIO * self._peak_n:
            self.snapshot = CycleImages(true, sensor, image_n)

    def _grid(self, content: bytes) -> npt.NDArray[np.float32]:
        return np.frombuffer(content, "<f4").reshape(self.layout.taxels.rows, self.layout.taxels.columns)

    def _kbit_per_s(self, loads: Sequence[float]) -> float | None:
        """Return the bits of all buses; None with CAN FD, whose load says nothing of bits."""
        if not loads or any(bus.fd for bus in self.layout.bus):
            return None
        bits = (load * bus.bitrate for load, bus in zip(loads, self.layout.bus, strict=False))
        return round(sum(bits) / 1000, 1)

    def report(self) -> Report:
        """Return the figures of the run so far."""
        gateway = self.gateway
        received = gateway.frames.received if gateway else 0
        sensor_db = _mean(self.psnr_sensor_db)
        sent = sum(status.frames_sent for status in self.nodes.values())
        # With steps, labels and truths have clocks of their own.
        contacts = max(self.named_contacts, self.labelled)
        loads = [bus.mean_load_ratio for bus in gateway.buses] if gateway else []
        return Report(
            sending=self.layout.sending,
            cycles=gateway.cycles if gateway else 0,
            cycles_complete=gateway.cycles_complete if gateway else 0,
            frames_sent=sent,
            frames_received=received,
            frames_lost=sent - received,
            frames_dropped=sum(status.frames_dropped for status in self.nodes.values()),
            frames_missing=gateway.frames.missing if gateway else 0,
            frames_late=gateway.frames.late if gateway else 0,
            nodes_missing=self._nodes_missing(),
            psnr_sensor_db=sensor_db,
            psnr_image_db=_mean(self.psnr_image_db),
            sensor_adds_noise=None if sensor_db is None else adds_noise(sensor_db, self.layout.taxels.adc_bits),
            contact_cycles=self.contact_cycles,
            label_accuracy=self.labelled_right / contacts if self.labelled else None,
            labelled_ratio=self.labelled / contacts if contacts else None,
            latency_ms=_percentiles(self.latency_ms),
            sample_age_ms=_percentiles(self.sample_age_ms).p99,
            sync_rate_hz=round(gateway.sync_rate_hz, 3) if gateway else 0.0,
            bus_load=[round(load, 4) for load in loads],
            kbit_per_s=self._kbit_per_s(loads),
            cpu_ratio=self.cpu_ratio,
            cores=os.cpu_count() or 0,
            scheduling=self.scheduling,
            doubtful_taxels=gateway.calibration.doubtful_taxels if gateway and gateway.calibration else 0,
        )


def _mean(values: Collection[float]) -> float | None:
    return round(sum(values) / len(values), 2) if values else None


def _percentiles(values: Collection[float]) -> Percentiles:
    return Percentiles(p50=_percentile(values, 50), p99=_percentile(values, 99))


def _percentile(values: Collection[float], percent: float) -> float | None:
    return round(float(np.percentile(list(values), percent)), 2) if values else None
