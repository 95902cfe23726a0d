"""``skin bench reconstruct --device``: the solvers on arrays against the compiled solvers of one core of the CPU."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np

from evaluation.bench.timing import race
from evaluation.result import Row
from reconstructor.array_api import ArrayLibrary, BatchSolver, array_library
from reconstructor.checks import Values
from reconstructor.engine import make_solver
from reconstructor.settings import PRESETS, Device, LibraryName
from skin.layout import load_layout
from skin.phi import Sbhe
from skin.taxel import sense
from touch.contact import Grid, press_along
from touch.objects import spheres_of
from touch.trajectory import paper_pose

#: Images solved together, on a GPU and on a CPU.
BATCHES: Final = {True: (1, 128, 1024, 4096), False: (1, 32)}
#: Frames of the paper's trajectory, and its steps from frame to frame.
FRAMES: Final = 60
STEP: Final = 7
#: Where the ball has been pressed in, and slides.
FIRST: Final = 1500


def run(rounds: int, device: Device, library: LibraryName | None) -> dict[str, Any]:
    """Return the library, and a row for each solver and batch.

    ``ratio`` is the time of the compiled solver / that of the library: above 1 the library is faster. Times
    contain the copies of sums and images to and from the device.
    """
    arrays = array_library(device, library)
    true = press_along(Grid(), spheres_of("golf-ball"), [paper_pose(FIRST + STEP * k) for k in range(FRAMES)])
    phi = load_layout().phi()
    batches = [row for name in ("variation", "spun", "paper") for row in _batches(name, phi, true, arrays, rounds)]
    return {"device": [{"library": arrays.about}], "batches": batches}


def _batches(name: str, phi: Sbhe, true: Values, library: ArrayLibrary, rounds: int) -> list[Row]:
    """Return the time of one image in batches of several sizes, and the largest difference from the compiled solver."""
    sizes = BATCHES[library.on_gpu]
    sums_n = _sums(phi, true, max(sizes))
    compiled = make_solver(phi, 64, 64, PRESETS[name])
    solver = BatchSolver(phi, 64, 64, PRESETS[name], library=library)
    batches = [solver.of_streams(size) for size in sizes]
    calls = [_call(compiled, sums_n[0]), *(_call(each, sums_n[: each.streams]) for each in batches)]
    wanted = calls[0]()
    differences = [float(np.abs(call()[0] - wanted).max()) for call in calls[1:]]
    own_s, *times_s = (float(np.median(each)) for each in race(calls, rounds))
    return [
        {
            "solver": name,
            "images": size,
            "us_of_image": 1e6 * each_s / size,
            "us_compiled": 1e6 * own_s,
            "ratio": own_s * size / each_s,
            "difference_un": 1e6 * difference,
        }
        for size, each_s, difference in zip(sizes, times_s, differences, strict=True)
    ]


def _call(solver: Any, sums_n: Values) -> Callable[[], Any]:
    """Return a solve of sums from the image before it, to an image of NumPy; the first starts from 0."""
    estimate = solver.new_estimate()

    def solve() -> Any:
        solver.solve(estimate, sums_n, np.ones_like(sums_n))
        return solver.deliver(estimate)

    return solve


def _forces(true: Values, count: int) -> Values:
    """Return the frames forwards, backwards, forwards and so on."""
    there_and_back = np.concatenate((np.arange(FRAMES), np.arange(FRAMES)[::-1]))
    return true[np.resize(there_and_back, count)]


def _sums(phi: Sbhe, true: Values, count: int) -> Values:
    felt = sense(_forces(true, count), np.random.default_rng(1))
    return np.asarray(phi.forward(felt.reshape(count, -1)), np.float32)
