"""The picture of Rerun: a golf ball slides past a ring, and a block is lost."""

import subprocess
import tempfile
from pathlib import Path
from typing import Final

import numpy as np
import rerun_cli

from canskin.messages import BusState, Contacts, FrameCounts, GatewayStatus, Image, Label, NmtState
from reconstructor.contacts import ContactTracker
from skin.layout import load_layout
from skin.wall_times import Clocks
from tests.browser import CHROMIUM, FLAGS, chromium
from tests.processes import free_port
from touch.contact import Grid, Pose, press
from touch.objects import spheres_of
from views.show.painter import Painter
from views.show.rerun_canvas import RerunCanvas

CYCLES: Final = 40
#: From this cycle on node 6 of the first bus is silent.
LOST: Final = 15
#: Rerun draws on a canvas, of which a page tells nothing: this long for the viewer to load on a slow machine.
LOADS_S: Final = 90.0
#: Rerun needs WebGL, which a processor computes here.
WEBGL: Final = (
    *(flag for flag in FLAGS if flag != "--disable-gpu"),
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"),
)
WIDTH, HEIGHT = 1500, 900


def rerun(path: Path) -> None:
    """Take a picture of Rerun's viewer in a browser."""
    if CHROMIUM is None:
        raise RuntimeError("expected chromium on PATH")
    with tempfile.TemporaryDirectory() as folder:
        recording = Path(folder) / "scene.rrd"
        _draw(recording)
        grpc, web = free_port(), free_port()
        binary = Path(rerun_cli.__file__).parent / "rerun"
        ports = ("--bind", "127.0.0.1", "--port", str(grpc), "--web-viewer-port", str(web))
        server = subprocess.Popen([binary, "--serve-web", *ports, recording], env={"RERUN_ANALYTICS": "0"})
        try:
            profile = Path(folder) / "chromium"
            profile.mkdir()
            with chromium(profile, WEBGL, 2 * LOADS_S) as browser:
                source = f"rerun%2Bhttp://127.0.0.1:{grpc}/proxy"
                browser.open(f"http://127.0.0.1:{web}/?url={source}&renderer=webgl", WIDTH, HEIGHT)
                for _ in range(round(LOADS_S / 5)):
                    browser.wait(5)
                path.write_bytes(browser.picture())
        finally:
            server.terminate()
            server.wait()


def _draw(path: Path) -> None:
    layout = load_layout()
    taxels, canvas = layout.taxels, RerunCanvas(layout, path)
    painter, tracker = Painter(layout, canvas), ContactTracker(taxels.surface)
    grid, ball, ring = Grid(taxels.rows, taxels.columns, taxels.pitch_m), spheres_of("golf-ball"), spheres_of("ring")
    painter.take(Clocks(0, 1_700_000_000_000_000_000), 0.0, 1_700_000_000_000_000_000)
    for cycle in range(1, CYCLES + 1):
        now_ns = cycle * 10_000_000
        stamps = {"cycle": cycle, "sync_counter": 1, "sampled_mono_ns": now_ns}
        poses = [(ball, Pose(-0.06 + 0.001 * cycle, -0.05, 0.0, 0.012)), (ring, Pose(0.03, 0.05, 0.0, 0.01))]
        force_n = np.minimum(press(grid, poses), np.float32(taxels.force_max_n))
        is_lost = cycle > LOST
        valid = np.ones(layout.blocks, np.uint8)
        valid[5] = not is_lost
        found, ended = tracker.take(force_n, now_ns, np.ones(force_n.shape, np.bool_))
        states = bytes([NmtState.OPERATIONAL] * 5 + [255 if is_lost else NmtState.OPERATIONAL])
        messages = [
            Image(
                **stamps,
                published_mono_ns=now_ns,
                pixels=force_n.tobytes(),
                valid=valid.tobytes(),
                valid_sums=1024,
                solve_s=0.0,
            ),
            Contacts(**stamps, contacts=found, ended=ended, find_s=0.0),
            Label(**stamps, label="golf-ball", confidence=0.9, valid_sums=1024),
            GatewayStatus(
                time_ns=0,
                cycles=cycle,
                cycles_complete=min(cycle, LOST),
                frames=FrameCounts(),
                sync_rate_hz=100.0,
                buses=[BusState(name=layout.bus[0].name, load_ratio=0.76, nodes=list(range(1, 7)), nmt=states)],
            ),
        ]
        for message in messages:
            painter.take(message, now_ns * 1e-9, 1_700_000_000_000_000_000 + now_ns)
    canvas.close()
