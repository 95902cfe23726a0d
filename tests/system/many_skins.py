"""Skins without boards, and workers that are killed or stopped while they serve them.

``python -m tests.system.many_skins 100 kill stop`` does both a hundred times in all, and prints the losses; ``unshare
-Urn sh -c "ip link set lo up; python -m tests.system.many_skins 20 cut"`` cuts them off; ``... carry SIDE COUNT...``
tells what one worker needs for these numbers of skins of SIDE x SIDE taxels; ``... gateways ENDPOINT SIDE RATE_HZ
NAME...`` runs the gateways alone: each publishes sums of a ball that moves.
"""

import json
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, Final

import numpy as np

from canskin.fabric import Fabric, Rising
from canskin.messages import IMAGE, MEASUREMENT, SERVICES, CycleMeasurement, Image, ServiceStatus
from gateway.duty import Duties
from shell.service import StopSignal
from shell.skin_options import join
from skin.layout import Layout
from tests.layouts import any_layout
from tests.messages import counter_of, measurement
from tests.processes import PATIENCE_S, Processes, free_endpoint

SIDE: Final = 16
RATE_HZ: Final = 100.0
#: For how long a worker is stopped.
STOPPED_CYCLES: Final = 60


def measurements(layout: Layout) -> list[CycleMeasurement]:
    """Return the sums of a ball that goes round once in 100 cycles, with noise."""
    phi, rng, taxels = layout.phi(), np.random.default_rng(1), layout.taxels
    place = np.stack(np.indices((taxels.rows, taxels.columns)), axis=-1)
    valid = np.ones(phi.blocks, np.uint8).tobytes()
    made = []
    for cycle in range(100):
        angle = 2 * np.pi * cycle / 100
        centre = taxels.rows / 2 + taxels.rows / 4 * np.array((np.cos(angle), np.sin(angle)))
        force_n = 0.01 * np.exp(-((place - centre) ** 2).sum(axis=-1) / 8) + rng.normal(0, 2e-4, place.shape[:2])
        counts = np.rint(force_n.clip(0) / taxels.newton_per_count).astype(np.int32)
        sums = np.asarray(phi.forward(counts.ravel()), "<i4").tobytes()
        made.append(measurement(sums=sums, valid=valid, fingerprint=phi.fingerprint))
    return made


def serve_gateways(endpoint: str, side: int, rate_hz: float, names: list[str]) -> None:
    """Publish the measurements of skins until a signal comes; the first gateway is the hub."""
    stop, skins = StopSignal().install(), []
    with ExitStack() as stack:
        for name in names:
            layout = any_layout(side, side, name=name, sync={"rate_hz": rate_hz})
            fabric = stack.enter_context(closing(join(layout, "gateway", endpoint, hub=not skins)))
            duties = Duties(fabric, name, layout.operator().fingerprint, lambda text, name=name: print(name, text))
            skins.append((fabric, duties, measurements(layout)))
        print("up", flush=True)
        cycle, due_s, late = 0, time.monotonic(), 0
        while not stop.is_set():
            cycle, due_s = cycle + 1, due_s + 1 / rate_hz
            time.sleep(max(0.0, due_s - time.monotonic()))
            if time.monotonic() - due_s > 5 / rate_hz:
                due_s, late = time.monotonic(), late + 1
            for fabric, duties, made in skins:
                duties.turn(time.monotonic())
                told = made[cycle % len(made)]
                about: dict[str, Any] = {name: getattr(told, name) for name in ("sums", "valid", "fingerprint")}
                about |= {"cycle": cycle, "sync_counter": counter_of(cycle), "sampled_mono_ns": time.monotonic_ns()}
                fabric.publish(MEASUREMENT, CycleMeasurement(**about, duty=duties.words))
                duties.sent(time.monotonic())
        print("cycles", cycle, "late", late, flush=True)


class Reader:
    """Keeps when each image of a skin came, all of them, and which of them a reader takes."""

    def __init__(self, fabric: Fabric) -> None:
        self.images: Counter[int] = Counter()
        self.taken: list[tuple[float, int]] = []
        self.late = 0
        self._rising = Rising()
        self._came = threading.Condition()
        fabric.subscribe_bytes(IMAGE, self._take)
        fabric.subscribe(SERVICES, self._note)
        self._told: dict[str, float] = {}
        self._decode = IMAGE.decoder()

    def _take(self, content: bytes, origin: Any) -> None:
        image: Image = self._decode(content)
        now_s = time.monotonic()
        with self._came:
            self.images[image.cycle] += 1
            if TAKES(self._rising, origin.publisher, image.sampled_mono_ns, now_s):
                self.taken.append((now_s, image.cycle))
            else:
                self.late += 1
            self._came.notify_all()

    def _note(self, status: ServiceStatus) -> None:
        with self._came:
            self._told[status.instance] = time.monotonic()
            self._came.notify_all()

    def await_images(self, cycles: int) -> None:
        """Wait for the image of a cycle that is so much later than the newest."""
        with self._came:
            until = cycles + (self.taken[-1][1] if self.taken else 0)
            assert self._came.wait_for(lambda: bool(self.taken) and self.taken[-1][1] >= until, PATIENCE_S)

    def await_two(self, after_s: float) -> None:
        """Wait until two reconstructors have told of themselves after an instant."""
        with self._came:
            assert self._came.wait_for(lambda: sum(each > after_s for each in self._told.values()) >= 2, PATIENCE_S)


#: What the fabric does, which lets all pass here.
TAKES: Final = Rising.takes


class Workers:
    """Two workers, each with what can befall it; those that can be cut off have networks of their own.

    For these `endpoint` listens in a network of this process alone.
    """

    def __init__(self, processes: Processes, endpoint: str, *, are_far: bool) -> None:
        self._processes, self._endpoint, self._are_far = processes, endpoint, are_far
        for number in range(2):
            self.start(number)

    def start(self, number: int) -> None:
        """Start a worker that does not run."""
        if self._processes.runs(f"worker {number}"):
            return
        verb = [sys.executable, "-m", "skin", "reconstruct", "--priority", "normal", "--connect"]
        if not self._are_far:
            self._processes.start(f"worker {number}", *verb, self._endpoint)
            return
        near, far, place = f"near{number}", f"far{number}", f"10.0.{number}"
        set_up = (
            f"until ip link show {far}; do sleep 0.1; done; ip addr add {place}.2/24 dev {far}; ip link set {far} up"
        )
        verb = [*verb, f"tcp/{place}.1:{self._endpoint.rpartition(':')[2]}"]
        self._processes.start(f"worker {number}", "unshare", "--net", "sh", "-euc", f'{set_up}; exec "$@"', "sh", *verb)
        ip(f"link add {near} type veth peer name {far} netns {self._processes.number(f'worker {number}')}")
        ip(f"addr add {place}.1/24 dev {near}")
        ip(f"link set {near} up")

    def begin(self, fault: str, number: int) -> None:
        """Kill a worker, stop it, or cut it off."""
        if fault == "kill":
            self._processes.stop(f"worker {number}", signal.SIGKILL)
        elif fault == "stop":
            self._processes.send_signal(f"worker {number}", signal.SIGSTOP)
        else:
            ip(f"link set near{number} down")

    def end(self, fault: str, number: int) -> None:
        """Let a worker go on that was not killed."""
        if fault == "stop":
            self._processes.send_signal(f"worker {number}", signal.SIGCONT)
        elif fault == "cut":
            ip(f"link set near{number} up")


def ip(words: str) -> None:
    """Change the network of this process."""
    subprocess.run(["ip", *words.split()], check=True)


def disturb(processes: Processes, endpoint: str, names: list[str], faults: list[tuple[str, int]]) -> dict[str, Any]:
    """Have two workers serve skins, let each fault befall one of them, and return what readers saw."""
    processes.start("gateways", *GATEWAYS, endpoint, str(SIDE), str(RATE_HZ), *names)
    processes.await_words("gateways", "up")
    Rising.takes = lambda *_: True  # type: ignore[method-assign]  # each image is seen, and judged here
    try:
        with ExitStack() as stack:
            fabrics = [stack.enter_context(closing(Fabric(name, "", endpoint))) for name in names]
            readers = [Reader(fabric) for fabric in fabrics]
            workers = Workers(processes, endpoint, are_far=any(fault == "cut" for fault, _ in faults))
            since_s = time.monotonic()
            for fault, number in faults:
                for each in range(2):
                    workers.start(each)
                for reader in readers:
                    reader.await_two(since_s)
                workers.begin(fault, number)
                for reader in readers:
                    reader.await_images(STOPPED_CYCLES)
                since_s = time.monotonic()
                workers.end(fault, number)
    finally:
        Rising.takes = TAKES  # type: ignore[method-assign]
    gaps_s = [float(np.diff([at_s for at_s, _ in each.taken]).max()) for each in readers]
    return {
        "faults": len(faults),
        "longest_gap_s": round(max(gaps_s), 3),
        "doubled": sum(count > 1 for each in readers for count in each.images.values()),
        "images": sum(len(each.taken) for each in readers),
        "missing": sum(each.taken[-1][1] - each.taken[0][1] + 1 - len(each.taken) for each in readers),
        "late": sum(each.late for each in readers),
    }


def carry(processes: Processes, endpoint: str, side: int, count: int) -> dict[str, Any]:
    """Have one worker serve skins of SIDE x SIDE taxels, and return what it tells of itself, once settled, in 5 s."""
    names = [f"skin{number}" for number in range(count)]
    processes.start("gateways", *GATEWAYS, endpoint, str(side), str(RATE_HZ), *names)
    processes.await_words("gateways", "up")
    told: dict[str, list[ServiceStatus]] = {name: [] for name in names}
    with ExitStack() as stack:
        for name in names:
            fabric = stack.enter_context(closing(Fabric(name, "", endpoint)))
            fabric.mailbox(IMAGE)  # so that images are sent
            fabric.subscribe(SERVICES, told[name].append)
        processes.skin("worker", "reconstruct", "--connect", endpoint, "--priority", "normal")
        processes.until(lambda: min(map(len, told.values())) >= 8, "eight statuses of each skin")
    settled = [each[-6:] for each in told.values()]
    return {
        "skins": count,
        "taxels": side**2,
        "load_ratio": round(float(np.mean([each.load_ratio for statuses in settled for each in statuses[1:]])), 2),
        "images_per_s": round(
            sum((each[-1].made - each[0].made) * 1e9 / (each[-1].time_ns - each[0].time_ns) for each in settled)
        ),
        "overruns": sum(each[-1].overruns - each[0].overruns for each in settled),
        "memory_mb": max(each[-1].memory_bytes for each in settled) >> 20,
    }


GATEWAYS: Final = (sys.executable, "-m", "tests.system.many_skins", "gateways")

if __name__ == "__main__":
    if sys.argv[1:2] == ["gateways"]:
        serve_gateways(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), sys.argv[5:])
    elif sys.argv[1:2] == ["carry"]:
        for given in sys.argv[3:]:
            with tempfile.TemporaryDirectory() as folder, Processes(Path(folder)) as processes:
                print(json.dumps(carry(processes, free_endpoint(), int(sys.argv[2]), int(given))), flush=True)
    else:
        rng, count, kinds = random.Random(1), int(sys.argv[1]), sys.argv[2:]
        endpoint = "tcp/0.0.0.0:7447" if "cut" in kinds else free_endpoint()
        with tempfile.TemporaryDirectory() as folder, Processes(Path(folder)) as processes:
            faults = [(rng.choice(kinds), rng.randrange(2)) for _ in range(count)]
            print(json.dumps(disturb(processes, endpoint, [f"skin{number}" for number in range(8)], faults)))
