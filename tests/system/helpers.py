"""``skin`` as a process that ends, the figures of a demo, and what services give."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from canskin.fabric import Fabric
from canskin.messages import IMAGE, LABEL, MEASUREMENT, Image, Label, Measurement
from tests.processes import Processes


def skin(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "skin", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=240, check=False)


def report(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    """Return the figures of a run: nothing was lost on the buses, and at least half of the cycles were complete."""
    assert done.returncode == 0, done.stderr
    figures: dict[str, Any] = json.loads(done.stdout)
    assert figures["frames_lost"] == 0
    assert figures["frames_sent"] == figures["frames_received"] > 0
    assert figures["cycles"] / 2 < figures["cycles_complete"] <= figures["cycles"]
    return figures


def first_image(running: Processes, endpoint: str) -> Image:
    """Wait for a whole measurement, then for an image of a whole measurement, then for a label; return the image."""
    measurements: list[Measurement] = []
    images: list[Image] = []
    labels: list[Label] = []
    fabric = Fabric("skin", "test", endpoint)
    try:
        fabric.subscribe(MEASUREMENT, measurements.append)
        fabric.subscribe(IMAGE, images.append)
        fabric.subscribe(LABEL, labels.append)
        running.until(lambda: any(min(each.valid) == 1 for each in measurements), "a whole measurement")
        running.until(lambda: any(min(each.valid) == 1 for each in images), "an image of a whole measurement")
        running.until(lambda: bool(labels), "a label")
    finally:
        fabric.close()
    return next(each for each in images if min(each.valid) == 1)
