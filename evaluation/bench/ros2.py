"""Time from an image on the fabric to the same image in the hands of a reader on ROS 2, in one process."""

import queue
import threading
import time
from functools import partial
from typing import Any, Final

import numpy as np

from canskin.errors import RunError
from canskin.fabric import Fabric
from canskin.messages import IMAGE, Image
from demo.run import open_hub
from shell.clock import wall_offset
from shell.service import StopSignal
from skin.layout import Layout, load_layout
from skin.wall_times import CLOCKS, Clocks
from views.ros2.bridge import Bridge
from views.ros2.node import RosNode
from views.ros2.reader import RosReader
from views.ros2.topics import FORCE_IMAGE, HEAT_MAP, TAXEL_CLOUD, RosTopic

#: Images of a round, at the rate of the default skin.
_IMAGES: Final = 100
_PATIENCE_S: Final = 10.0


def run(rounds: int) -> dict[str, Any]:
    """Return the latency of 100 images a round at 100 Hz: with a reader of the images, and with readers of all topics.

    Raises
    ------
    RunError
        If no image came.
    """
    layout = load_layout()
    endpoint, hub = open_hub(layout.name, None)
    fabric, node = Fabric(layout.name, "ros2", endpoint), RosNode(endpoint, domain=0, namespace="/skin", name="bench")
    bridge, stop = Bridge(layout, fabric, node, layout.name), StopSignal()
    running = threading.Thread(target=bridge.run, args=(stop,))
    running.start()
    try:
        rows = [
            {"readers of": " ".join(topic.name for topic in topics)}
            | _latency(layout, hub, endpoint, topics, rounds * _IMAGES)
            for topics in ((FORCE_IMAGE,), (FORCE_IMAGE, HEAT_MAP, TAXEL_CLOUD))
        ]
    finally:
        stop.set()
        running.join()
        for each in (node, fabric, hub):
            each.close()
    return {"image on the fabric to image at a reader on ROS 2": rows}


def _latency(layout: Layout, hub: Fabric, endpoint: str, topics: tuple[RosTopic, ...], count: int) -> dict[str, Any]:
    """Return the latency of `count` images that came, and how many others did not; each is awaited before the next."""
    reader, came = RosReader(endpoint), {topic.name: queue.Queue[tuple[int, bytes]]() for topic in topics}

    def note(name: str, message: Any) -> None:
        came[name].put((time.monotonic_ns(), message.data.tobytes()))

    for topic in topics:
        reader.subscribe(f"/skin/{topic.name}", topic.ros_type, partial(note, topic.name))
    try:
        pixels = np.random.default_rng(1).random(layout.taxels.count, np.float32)
        _await_first(layout, hub, came[FORCE_IMAGE.name], pixels)
        latencies_s, equal, lost = list[float](), 0, 0
        while len(latencies_s) < count:
            started_ns = time.monotonic_ns()
            pixels[0] = len(latencies_s)
            hub.publish(IMAGE, _image(layout, len(latencies_s) + lost, pixels))
            try:
                arrived_ns, content = came[FORCE_IMAGE.name].get(timeout=_PATIENCE_S)
            except queue.Empty as error:
                lost += 1  # best effort: a machine whose processors are all busy may lose an image
                if lost > count / 10:
                    raise RunError(f"{lost} images did not come") from error
                continue
            latencies_s.append((arrived_ns - started_ns) * 1e-9)
            equal += content == pixels.tobytes()
            time.sleep(max(0.0, layout.sync.period_s - (time.monotonic_ns() - started_ns) * 1e-9))
    finally:
        reader.close()
    p50_s, p99_s = np.percentile(latencies_s, (50, 99))
    return {"images": count, "lost": lost, "equal": equal, "median_ms": 1e3 * p50_s, "p99_ms": 1e3 * p99_s}


def _await_first(layout: Layout, hub: Fabric, came: "queue.Queue[tuple[int, bytes]]", pixels: Any) -> None:
    """Publish until the reader is known to all, and let the last images of this time come."""
    ends_s = time.monotonic() + _PATIENCE_S
    while came.empty():
        if time.monotonic() > ends_s:
            raise RunError("no image came")
        hub.publish(CLOCKS, Clocks(time.monotonic_ns(), wall_offset().ns))
        hub.publish(IMAGE, _image(layout, 0, pixels))
        time.sleep(layout.sync.period_s)
    time.sleep(0.5)
    while not came.empty():
        came.get()


def _image(layout: Layout, number: int, pixels: Any) -> Image:
    now_ns = time.monotonic_ns()
    return Image(
        cycle=number,
        sync_counter=1,
        sampled_mono_ns=now_ns,
        published_mono_ns=now_ns,
        pixels=pixels.tobytes(),
        valid=b"\1" * layout.blocks,
        valid_sums=layout.measurement.sums,
        solve_s=0.0,
    )
