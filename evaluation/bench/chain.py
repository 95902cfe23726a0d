"""``skin bench chain``: processor time of each process of ``skin demo``, and where the time until an image goes."""

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from canskin.errors import RunError
from canskin.messages import MEASUREMENT, Image, Measurement
from demo.folder import run_folder
from demo.options import DemoOptions
from demo.run import Run, execute
from demo.score import Score
from shell.service import StopSignal
from skin.layout import load_layout

#: The skins, one after the other in each round; None is the default skin.
LAYOUTS: Final = (None, Path("steps"))
#: Time of a run, without its start.
RUN_S: Final = 10.0
#: Measurements whose arrival is kept until an image of them comes.
_KEPT: Final = 1024


class _Steps(NamedTuple):
    """The steps of one image, nanoseconds. A sample is SYNC, or the end of the newest frame with steps."""

    sample_to_measurement: int
    measurement_to_solver: int
    solver: int
    image_to_client: int
    in_all: int


@dataclass
class _Timed(Score):
    """A score that also notes when measurements and images come to a client; the clock is that of their stamps.

    Attributes
    ----------
    steps : list of _Steps
        Of the first image of each measurement that has new sums.
    """

    topics = (*Score.topics, (MEASUREMENT, "take_measurement"))
    steps: list[_Steps] = field(default_factory=list)
    _came_ns: dict[int, tuple[int, int]] = field(default_factory=dict)

    def take_measurement(self, measurement: Measurement) -> None:
        """Note when the sums of a measurement were sampled, and when it came."""
        self._came_ns[measurement.cycle] = measurement.sampled_mono_ns, time.monotonic_ns()
        if len(self._came_ns) > _KEPT:
            self._came_ns.pop(next(iter(self._came_ns)), None)

    def take_image(self, image: Image) -> None:
        """Note the steps of an image whose measurement came."""
        now_ns = time.monotonic_ns()
        sampled_ns, measured_ns = self._came_ns.pop(image.cycle, (0, 0))
        if image.valid_sums and sampled_ns == image.sampled_mono_ns:
            solved_ns = round(image.solve_s * 1e9)
            self.steps.append(
                _Steps(
                    measured_ns - sampled_ns,
                    image.published_mono_ns - solved_ns - measured_ns,
                    solved_ns,
                    now_ns - image.published_mono_ns,
                    now_ns - sampled_ns,
                )
            )
        super().take_image(image)


def run(rounds: int) -> dict[str, Any]:
    """Return the share of a core that each process takes, and the latency of each step, of `rounds` runs of each skin.

    The step from the measurement to the solver counts from the arrival of the measurement at the client, which has the
    same way as to the reconstructor: a reconstructor that has it first makes a step below 0.

    Raises
    ------
    RunError
        If no image came.
    """
    runs = [[_timed(layout) for layout in LAYOUTS] for _ in range(rounds)]
    processors, steps = [], []
    for each, layout in zip(zip(*runs, strict=True), LAYOUTS, strict=True):
        name = str(layout or "default")
        processors.append({"skin": name} | _processors(each))
        steps += [{"skin": name} | row for row in _latencies([row for one in each for row in one.steps])]
    return {"processor time / wall time, median of runs": processors, "time of a step": steps}


def _timed(layout: Path | None) -> _Timed:
    """Run the chain of a layout once."""
    options = DemoOptions(layout=[layout] if layout else [], seconds=RUN_S, port=0)
    skin = load_layout(layout)
    with run_folder() as folder:
        chain = Run(skin, options, folder)
        chain.score = _Timed(skin)
        execute([chain], options, folder, StopSignal())
    if not isinstance(chain.score, _Timed) or not chain.score.steps:
        raise RunError(f"no image came in {RUN_S:g} s of the {layout or 'default'} skin")
    return chain.score


def _processors(runs: Sequence[Score]) -> dict[str, float]:
    """Return the median over the runs of each process."""
    return {name: float(np.median([one.cpu_ratio[name] for one in runs])) for name in runs[0].cpu_ratio}


def _latencies(steps: list[_Steps]) -> list[dict[str, Any]]:
    """Return one row of each step."""
    times_ms = np.array(steps).T * 1e-6
    return [
        {"step": name.replace("_", " "), "images": own_ms.size}
        | {f"{part}_ms": float(np.percentile(own_ms, percent)) for part, percent in (("p50", 50), ("p99", 99))}
        for name, own_ms in zip(_Steps._fields, times_ms, strict=True)
    ]
