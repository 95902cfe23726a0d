"""What each contender shows at one instant."""

from typing import Final

import numpy as np
from matplotlib.figure import Figure

from dbc.contract import contract
from evaluation.schemes.events import EventRule, run_events
from evaluation.schemes.judge import Images, Updates
from evaluation.schemes.scan import run_scan
from evaluation.schemes.scenes import NEWTON_PER_COUNT, Scene, scene
from evaluation.schemes.smoothing import CELLS_PENALTY_N, refined, smoothed
from evaluation.schemes.sums import run_sums
from skin.layout import load_layout
from touch.arrays import averaged
from touch.contact import Force
from touch.electronics import sense

#: Touches, and the instants that are shown.
INSTANTS: Final = (("three boxes slapped on", 315), ("three boxes slapped on", 320), ("faint box", 700))
#: As often as the default skin's bits allow.
SCAN_HZ, COARSE_HZ = 39.0, 148.0
SCALE_MN: Final = 10.0


def images_figure() -> Figure:
    """Draw truth and contenders side by side."""
    figure = Figure(figsize=(12, 2.7 * len(INSTANTS)), layout="constrained")
    panels = figure.subplots(len(INSTANTS), 5, squeeze=False)
    for row, (name, tick) in zip(panels, INSTANTS, strict=True):
        what = scene(name, ticks=tick + 1)
        shown = {"truth": what.true_n[tick], **_shown(what, tick)}
        for panel, (title, force_n) in zip(row, shown.items(), strict=True):
            drawn = panel.imshow(1e3 * force_n.reshape(64, 64), vmin=0, vmax=SCALE_MN, cmap="viridis")
            panel.set_title(f"{name},\n{tick} ms: truth" if title == "truth" else title, fontsize="small")
            panel.set_axis_off()
    figure.colorbar(drawn, ax=panels, label="mN", shrink=0.7)
    return figure


def _shown(what: Scene, tick: int) -> dict[str, Force]:
    """Return what each contender has in use at `tick`."""
    made = contract(load_layout())
    coarse = averaged(what.true_n.reshape(-1, 64, 64), 32).reshape(len(what.true_n), -1)
    cells = run_scan(sense(coarse, np.random.default_rng(1)), 10, COARSE_HZ)
    held = smoothed(cells.updates.held(cells.scan_ns, 1024), CELLS_PENALTY_N)
    events = run_events(what.counts, NEWTON_PER_COUNT, EventRule(4e-3))
    return {
        "sums, 16 bits": _at(run_sums(made, what.counts).images(made), tick),
        "scan, 10 bits": _at(run_scan(what.felt_n, 10, SCAN_HZ).updates, tick),
        "32 x 32, solved": _at(refined(held, 3), tick),
        "events, 4 mN": _at(events.updates, tick),
    }


def _at(shown: Images | Updates, tick: int) -> Force:
    now = np.array([tick * 1_000_000])
    images = shown.held(now, 4096) if isinstance(shown, Updates) else shown
    used = int(np.searchsorted(images.ready_ns, now[0], side="right")) - 1
    force_n: Force = images.force_n[used] if used >= 0 else np.zeros(4096, np.float32)
    return force_n
