"""``skin`` as a process that ends, and the figures of a demo."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any


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
