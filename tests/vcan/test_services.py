"""All services of the default skin on a real kernel: image, label and page are those of the measurements.

No service has real-time priority here: on the one processor of a guest, nodes and gateway would leave nothing to the
others.
"""

import struct
import sys
import threading
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from websockets.sync.client import connect

from canskin.fabric import Fabric
from canskin.messages import IMAGE, LABEL, TRUTH, Image, Label, Measurement, NmtState, Truth
from demo.score import Score
from reconstructor.imaging import make_imager
from reconstructor.service import ReconstructorService
from skin.layout import load_layout
from tests.layouts import slow_layout
from tests.messages import Published
from tests.processes import PATIENCE_S, Processes, free_endpoint, free_port
from tests.vcan.chain import Chain, complete

#: Rates, the highest first, and the part of the cycles that has to be complete at a rate that the machine keeps.
#: A slow guest keeps none of the first.
COMPLETE_RATIOS: Final = {40.0: 0.9, 20.0: 0.9, 10.0: 0.4, 5.0: 0.4, 2.0: 0.4}
RATES_HZ: Final = tuple(COMPLETE_RATIOS)
#: Cycles of a look.
LOOK: Final = 25
#: Longest time until the gateway has proven the nodes and a cycle is complete; then the rate is too high.
START_S: Final = 40.0
#: The page acknowledges so late: each frame costs the guest some milliseconds.
PAGE_S: Final = 0.2
#: What is waited for: objects that touched, labels of cycles with contact, frames of the page.
OBJECTS, LABELS, FRAMES = 2, 40, 20
#: Cycles with the right label / cycles with contact. A label settles over two cycles, of a press of 3 s.
RIGHT_RATIO: Final = 0.75
SERVICES: Final = {"reconstructor": "reconstruct", "classifier": "classify", "viewer": "view"}

Pictures = dict[str, npt.NDArray[np.float32]]


@dataclass
class Run:
    """What the services of a run have published, and what its page has shown."""

    chain: Chain
    #: Of complete cycles.
    score: Score
    images: list[Image] = field(default_factory=list)
    labels: list[Label] = field(default_factory=list)
    #: Objects that touched.
    objects: set[str] = field(default_factory=set)
    #: Snapshot and pictures of each frame of the page.
    frames: list[tuple[dict[str, Any], Pictures]] = field(default_factory=list)
    index: str = ""

    def take_truth(self, truth: Truth) -> None:
        self.score.take_truth(truth)
        self.objects |= {truth.label} - {""}

    def take_image(self, image: Image) -> None:
        self.images.append(image)
        if image.valid_sums == self.chain.layout.measurement.sums:
            self.score.take_image(image)

    def take_label(self, label: Label) -> None:
        self.labels.append(label)
        if label.valid_sums == self.chain.layout.measurement.sums:
            self.score.take_label(label)

    def keeps(self, rate_hz: float) -> bool:
        """Tell whether most cycles are complete, and SYNC is sent at its rate."""
        first = len(self.chain.measurements)

        def is_started() -> bool:
            new = self.chain.measurements[first:]
            return any(map(complete, new)) or span_s(new) > START_S

        self.chain.processes.until(is_started, "a complete measurement")
        look = self.chain.await_cycles(LOOK)
        ratio, sent_hz = sum(map(complete, look)) / LOOK, (LOOK - 1) / span_s(look)
        print(f"{rate_hz:g} Hz: SYNC at {sent_hz:.1f} Hz, {ratio:.0%} of the cycles complete")
        return ratio >= COMPLETE_RATIOS[rate_hz] and sent_hz >= 0.9 * rate_hz


def span_s(measurements: list[Measurement]) -> float:
    """Return the time from the first measurement to the last."""
    return 1e-9 * (measurements[-1].sampled_mono_ns - measurements[0].sampled_mono_ns) if measurements else 0.0


def start(processes: Processes, name: str, *arguments: str) -> None:
    """Start a service without the right to real-time priority."""
    without = ("setpriv", "--bounding-set", "-sys_nice")
    processes.start(name, *without, sys.executable, "-m", "skin", *arguments)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    folder, port, endpoint = tmp_path_factory.mktemp("services"), free_port(), free_endpoint()
    paths = {rate_hz: slow_layout(tmp_path_factory.mktemp("layout"), rate_hz) for rate_hz in RATES_HZ}
    fabric = Fabric(load_layout().name, "test", endpoint, hub=True)
    try:
        with Processes(folder) as processes:
            yield started(processes, fabric, paths, endpoint, port)
    finally:
        fabric.close()


def started(processes: Processes, fabric: Fabric, paths: dict[float, Path], endpoint: str, port: int) -> Run:
    """Run all services at the highest rate that the machine keeps, until enough has come; then stop them."""
    layouts = {rate_hz: load_layout(path) for rate_hz, path in paths.items()}
    first = paths[RATES_HZ[0]]
    run = Run(Chain(layouts[RATES_HZ[0]], first, processes, fabric), Score(layouts[RATES_HZ[0]]))
    for topic, handler in ((TRUTH, run.take_truth), (IMAGE, run.take_image), (LABEL, run.take_label)):
        fabric.subscribe(topic, handler)
    alive: set[str] = set()
    fabric.watch(lambda name, there: alive.add(name) if there else alive.discard(name))
    page = {"viewer": ("--port", str(port))}
    for name, verb in SERVICES.items():  # Φ, and with it these services, are the same at every rate
        start(processes, name, verb, "--layout", str(first), "--connect", endpoint, *page.get(name, ()))
    processes.until(lambda: alive >= SERVICES.keys(), "reconstructor, classifier and viewer", 0.1)
    for rate_hz, path in paths.items():
        common = ("--layout", str(path), "--connect", endpoint)
        bus = ("-i", "socketcan", "-c", "vcan0")
        start(processes, "nodes", "nodes", *bus, *common)
        processes.until(lambda: "nodes" in alive, "the nodes", 0.1)
        start(processes, "gateway", "gateway", *bus, *common)
        if run.keeps(rate_hz):
            run.score = Score(layouts[rate_hz])
            watch(run, port)
            return run
        for name in ("gateway", "nodes"):
            processes.stop(name)
        processes.until(lambda: "nodes" not in alive, "the end of the nodes", 0.1)
    pytest.fail(f"the machine kept none of {RATES_HZ} Hz")


def watch(run: Run, port: int) -> None:
    """Look at the page until enough has come, and stop the services."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=PATIENCE_S) as answer:
        run.index = answer.read().decode()
    ended, processes = threading.Event(), run.chain.processes
    looking = threading.Thread(target=look_at_page, args=(run, port, ended))
    looking.start()
    try:
        processes.until(
            lambda: len(run.frames) >= FRAMES or not looking.is_alive(), f"{FRAMES} frames of the page", 0.1
        )
        processes.until(lambda: run.score.labelled >= LABELS, f"{LABELS} labels of complete cycles with contact", 0.1)
        processes.until(lambda: len(run.objects) >= OBJECTS, f"{OBJECTS} objects", 0.1)
    finally:
        ended.set()
        looking.join()
    for name in ("gateway", "nodes", *SERVICES):
        processes.stop(name)
    report = run.score.report()
    print(
        f"image {report.psnr_image_db} dB, one raw sample {report.psnr_sensor_db} dB,"
        f" label right {report.label_accuracy:.0%}"
    )


def look_at_page(run: Run, port: int, ended: threading.Event) -> None:
    """Be a page that shows a frame each `PAGE_S`."""
    with connect(f"ws://127.0.0.1:{port}/ws", max_size=None, open_timeout=PATIENCE_S, ping_interval=None) as page:
        skin = msgspec.json.decode(page.recv())
        shape = (-1, skin["rows"], skin["columns"])
        while not ended.wait(PAGE_S):
            content = page.recv()
            page.send("ok")
            (length,) = struct.unpack_from("<I", content)
            header = msgspec.json.decode(content[4 : 4 + length])
            pictures = np.frombuffer(content, "<f4", offset=4 + length).reshape(shape)
            run.frames.append((header["snapshot"], dict(zip(header["pictures"], pictures, strict=True))))


def test_images_are_those_of_the_measurements_bit_for_bit(run: Run) -> None:
    """From the first image on: each depends on those before."""
    measurements = {each.sampled_mono_ns: each for each in run.chain.measurements}
    kept, layout = Published(), run.chain.layout
    service = ReconstructorService(layout, make_imager(layout), kept)
    assert [image.number for image in run.images] == list(range(1, len(run.images) + 1))
    for image in run.images:
        service.take(msgspec.structs.replace(measurements[image.sampled_mono_ns], duty=""))
    again = kept.of(Image)
    assert len(again) == len(run.images)
    for image, solved in zip(run.images, again, strict=True):
        assert (image.cycle, image.pixels) == (solved.cycle, solved.pixels)
        assert image.valid == solved.valid


def test_images_are_nearer_to_the_true_forces_than_the_sensor_signal(run: Run) -> None:
    report = run.score.report()
    assert report.contact_cycles >= LABELS // 2
    assert report.psnr_image_db is not None
    assert report.psnr_sensor_db is not None
    assert report.psnr_image_db > report.psnr_sensor_db


def test_labels_name_the_objects_that_touch(run: Run) -> None:
    assert run.score.labelled_right >= RIGHT_RATIO * run.score.labelled
    assert len(run.objects & {each.label for each in run.labels}) >= OBJECTS


def test_page_shows_images_labels_and_nodes(run: Run) -> None:
    assert "<canvas" in run.index
    pixels = {image.cycle: image.pixels for image in run.images}  # of the newest gateway, if there were several
    said = {each.label for each in run.labels}
    snapshots = [snapshot for snapshot, _ in run.frames]
    shown = [(snapshot["image"], pictures) for snapshot, pictures in run.frames if "image" in pictures]
    assert len(shown) >= FRAMES // 2
    for image, pictures in shown:
        assert pictures["image"].tobytes() == pixels[image["cycle"]]
    named = {snapshot["label"]["label"] for snapshot in snapshots if snapshot["label"]}
    assert named <= said
    assert named & run.objects
    buses = snapshots[-1]["gateway"]["buses"]
    assert [set(bus["nmt"]) for bus in buses] == [{NmtState.OPERATIONAL}] * 4
    assert {name for name, service in snapshots[-1]["services"].items() if service["alive"]} >= SERVICES.keys()
