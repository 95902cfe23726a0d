"""Services are killed and stopped at random; under the watchdog of their units the skin is whole again without help.

``SKIN_HITS`` is the number of hits of each layout, 10 by default; ``pytest -s`` shows how long each took.
"""

import os
import random
import signal
import statistics
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import chain, count, islice, product
from pathlib import Path
from typing import Final

import pytest

from canskin.fabric import Fabric
from canskin.messages import IMAGE, LABEL, MEASUREMENT, SERVICES, Image, Label, Measurement, ServiceStatus
from skin.layout import layout_text, load_layout
from tests.layouts import slow_layout
from tests.processes import free_port
from tests.system.units import Units

pytestmark = pytest.mark.slow

HITS: Final = int(os.environ.get("SKIN_HITS", "10"))
HOW: Final = {"kill": signal.SIGKILL, "stop": signal.SIGSTOP}
#: Those that tell their status, which neither the buses nor the hub do.
TOLD: Final = ("nodes", "gateway", "reconstructor", "classifier", "viewer", "recorder")


class Seen:
    """When the newest sign of each part of a whole skin came."""

    def __init__(self, fabric: Fabric) -> None:
        self._came_s: defaultdict[str, float] = defaultdict(float)
        self._made: dict[str, int] = {}
        self._lock = threading.Lock()
        fabric.subscribe(MEASUREMENT, self._take("a measurement"))
        fabric.subscribe(IMAGE, self._take("an image"))
        fabric.subscribe(LABEL, self._take("a label"))
        fabric.subscribe(SERVICES, self._told)

    def lacks(self, since_s: float) -> list[str]:
        """Return what has not come since."""
        parts = ("a measurement", "an image", "a label", *TOLD)
        with self._lock:
            return [each for each in parts if self._came_s[each] <= since_s]

    def _take(self, name: str) -> Callable[[Measurement | Image | Label], None]:
        def take(message: Measurement | Image | Label) -> None:
            is_whole = not message.blind if isinstance(message, Label) else min(message.valid) == 1
            with self._lock:
                if is_whole:
                    self._came_s[name] = time.monotonic()

        return take

    def _told(self, status: ServiceStatus) -> None:
        with self._lock:
            if status.made != self._made.get(status.service) or status.service == "viewer":
                self._came_s[status.service] = time.monotonic()
            self._made[status.service] = status.made


@pytest.fixture(params=["default", "steps"])
def units(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[Units, Seen]]:
    """The services of a skin, each a unit, the hub among them."""
    if request.param == "default":
        layout = slow_layout(tmp_path, 20)
    else:
        layout = tmp_path / "steps.toml"
        layout.write_text(layout_text(load_layout(Path("steps"))))
    hub = f"tcp/127.0.0.1:{free_port()}"
    common = ("--layout", str(layout), "--connect", hub)
    made = Units(tmp_path)
    try:
        made.skin("hub", "hub", "--listen", hub)
        made.skin("bus", "bus", "--layout", str(layout))
        made.skin("nodes", "nodes", *common)
        made.skin("gateway", "gateway", *common)
        made.skin("reconstructor", "reconstruct", *common)
        made.skin("classifier", "classify", *common)
        made.skin("viewer", "view", *common, "--port", str(free_port()))
        record = f"exec {sys.executable} -m skin record $(mktemp -u -p {tmp_path} XXXXXX.mcap) {' '.join(common)}"
        made.start("recorder", "sh", "-c", record)
        with closing(Fabric(load_layout(layout).name, "", hub)) as fabric:
            yield made, Seen(fabric)
    finally:
        made.close()


def hit(skin: Units, seen: Seen, name: str, how: str) -> float:
    """Kill or stop a service; return after how many seconds the skin is whole again."""
    hit_s = time.monotonic()
    skin.hit(name, HOW[how])
    skin.until(lambda: skin.units[name].is_ready, f"{name} to be ready")
    ready_s = time.monotonic()
    skin.until(lambda: not seen.lacks(ready_s), f"a whole skin after {how} of {name}")
    whole_s = time.monotonic()
    times = (f"{each - hit_s:.1f} s" for each in (skin.units[name].launched_s, ready_s, whole_s))
    print("{} {}: started again after {}, ready {}, skin whole {}".format(how, name, *times), flush=True)
    return whole_s - hit_s


def test_a_skin_is_whole_again_whatever_is_killed_or_stopped(units: tuple[Units, Seen]) -> None:
    skin, seen = units
    skin.until(lambda: not seen.lacks(0.0), "a whole skin")
    hits, took_s = list(product(skin.units, HOW)), defaultdict[str, list[float]](list)
    drawn = random.Random(HITS)
    # All services alike, in a new order each time round.
    for name, how in islice(chain.from_iterable(drawn.sample(hits, len(hits)) for _ in count()), HITS):
        took_s[f"{how} {name}"].append(hit(skin, seen, name, how))
    for what, each in sorted(took_s.items()):
        print(f"{what:20} {len(each):3} times, whole after {min(each):.1f} to {max(each):.1f} s")
    every = sorted(value for each in took_s.values() for value in each)
    print(f"{len(every)} hits: median {statistics.median(every):.1f} s, longest {every[-1]:.1f} s")
    ended = {name: unit.ends for name, unit in skin.units.items()}
    assert sum(map(len, ended.values())) == HITS, ended  # nobody else's watchdog ran out
