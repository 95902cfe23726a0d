"""How good the images of a skin are, with its sums or other numbers of sums: simulated touches, nodes, solver."""

import math
from collections.abc import Iterator
from itertools import pairwise, product
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from bandwidth.plan import random_bus_time
from bandwidth.traffic import traffic
from canskin.errors import LayoutError, RunError
from canskin.messages import Image
from dbc.contract import Contract
from dbc.frame import ECHO, Frames
from gateway.batch import batch_of
from gateway.stepped_state import new_sums, slots_of, take_all
from nodes.simulated import REST_S, Nodes
from nodes.steps.simulated import sync_frames, touched_frames
from reconstructor.imaging import CycleImager
from reconstructor.walsh import WalshReconstructor
from shell.compiled import hold
from skin.ground_truth import LATENESS_NS, image_pairs, in_contact
from skin.layout import Layout, changed, validated
from skin.measured_sums import decode_measurement
from skin.psnr import decibels
from skin.sources import TaxelSource, load_objects, step_rate_hz
from skin.taxel import NOISE_N, sense, to_counts

#: Time of the simulated touches: each of the five default objects touches.
TOUCHES_S: Final = 12.0
#: Most taxels whose images are predicted without being asked, in some seconds: of sums in cycles, of steps.
PREDICTED_MAX: Final = 8192
STEPPED_MAX: Final = 512
#: Taxels per sum that are tried.
TAXELS_PER_SUM: Final = (16, 8, 4, 2, 1)
#: The constant of the paper's m ≥ 0.28 k log(p / k) (section III).
BOUND: Final = 0.28

#: Image, true forces and what the sensor reads at one instant, newtons, shape (n,).
Moment = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]


class Quality(NamedTuple):
    """What one number of sums gives.

    Attributes
    ----------
    sums : int
    sums_per_taxel : float
    psnr_image_db, psnr_sensor_db : float
        Means over the cycles in contact, of the image and of one raw sample of every taxel.
    touched_error_n : float
        Root mean square error of the taxels that something touches.
    bound_sums : float
        Median over these cycles of the paper's 0.28 k log(p / k), k of p taxels touched. The bound is for random
        sums and any k taxels; a touch has neighbours that feel alike, but noise.
    """

    sums: int
    sums_per_taxel: float
    psnr_image_db: float
    psnr_sensor_db: float
    touched_error_n: float
    bound_sums: float

    @property
    def words(self) -> str:
        """PSNR and error as text, and advice where the taxels alone are better."""
        against = f"{self.psnr_image_db:.1f} dB, one raw sample's {self.psnr_sensor_db:.1f} dB"
        is_worse = self.psnr_image_db < self.psnr_sensor_db
        advice = "; worse than the taxels themselves: these are too few sums (measurement.sums)" if is_worse else ""
        return f"{against}, {1e3 * self.touched_error_n:.2f} mN where touched{advice}"


def qualities(layout: Layout, *, touches_s: float = TOUCHES_S) -> list[Quality]:
    """Return the quality of a layout, and of sums in cycles with one sum for each of `TAXELS_PER_SUM` places.

    Stepped boards send all sums, and a matrix is as it is.

    Raises
    ------
    RunError
        If no object touches in `touches_s`.
    """
    found = [quality(layout, touches_s=touches_s)]
    if layout.sends.in_cycles and layout.measurement.matrix is None:
        found += [quality(each, touches_s=touches_s) for each in _drawn(layout)]
    return found


def _drawn(layout: Layout) -> Iterator[Layout]:
    """Yield the layout with other numbers of sums in every cycle, of drawn rows."""
    for each in TAXELS_PER_SUM:
        drawn = {"sums": layout.places // each, "rows": None, "selection": "balanced"}
        try:
            other = validated(changed(layout, measurement=drawn))
        except LayoutError:  # such sums cannot be shared evenly by the blocks
            continue
        if other.measurement.sums != layout.measurement.sums:
            yield other


def is_quick(layout: Layout) -> bool:
    """Tell whether the images of a layout are predicted in some seconds."""
    return layout.taxels.there <= (PREDICTED_MAX if layout.sends.in_cycles else STEPPED_MAX)


def quality(
    layout: Layout,
    *,
    touches_s: float = TOUCHES_S,
    source: TaxelSource | None = None,
) -> Quality:
    """Return the quality of a layout as it is.

    Boards that send in cycles lose no frame. Stepped boards send on simulated buses, and an image is of all that has
    come.

    Parameters
    ----------
    source : TaxelSource, optional
        What touches; default: the default objects, on boards in cycles after a rest of `REST_S`.

    Raises
    ------
    RunError
        If no object touches in `touches_s`.
    """
    taxels, wired = layout.taxels, layout.operator().is_wired
    if source is None:
        rest_s = REST_S if layout.sends.in_cycles else 0.0
        source, touches_s = load_objects(layout, rest_s=rest_s), rest_s + touches_s
    moments = _cycles if layout.sends.in_cycles else _steps
    imaged_n2, sensed_n2, touched_n2, touched = [], [], 0.0, []
    for image_n, true_n, sensor_n in moments(layout, source, touches_s):
        if not in_contact(true_n, taxels.force_max_n):
            continue
        error_n = (image_n - true_n)[wired]
        imaged_n2.append(float(np.mean(error_n**2)))
        sensed_n2.append(float(np.mean((sensor_n - true_n)[wired] ** 2)))
        is_touched = true_n[wired] > 0
        touched_n2 += float((error_n[is_touched] ** 2).sum())
        touched.append(int(is_touched.sum()))
    if not touched:
        raise RunError(f"nothing touched '{layout.name}' within {touches_s:g} s: expected a longer time")
    bounds = [BOUND * count * math.log(taxels.there / count) for count in touched]
    sums = layout.operator().shape[0]
    return Quality(
        sums=sums,
        sums_per_taxel=sums / taxels.there,
        psnr_image_db=float(decibels(imaged_n2, taxels.force_max_n).mean()),
        psnr_sensor_db=float(decibels(sensed_n2, taxels.force_max_n).mean()),
        touched_error_n=math.sqrt(touched_n2 / sum(touched)),
        bound_sums=float(np.median(bounds)),
    )


def _cycles(layout: Layout, source: TaxelSource, seconds: float) -> Iterator[Moment]:
    """Yield each truth of boards that send in cycles, with the image that a run compares with it."""
    phi, imager, pairs = layout.operator(), CycleImager(layout), image_pairs(layout)
    nodes, late_ns = Nodes(layout, source, seed=0), _late_ns(layout)
    for _ in range(round(seconds * step_rate_hz(layout))):
        measurement = nodes.measurement(nodes.sample())
        image = Image(
            cycle=measurement.cycle,
            sync_counter=measurement.sync_counter,
            sampled_mono_ns=measurement.sampled_mono_ns,
            published_mono_ns=measurement.sampled_mono_ns + late_ns,
            pixels=imager.solve(decode_measurement(measurement, phi))[0].tobytes(),
            valid=measurement.valid,
            valid_sums=phi.shape[0],
            solve_s=0.0,
        )
        for shown, truth in (*pairs.take_truth(nodes.truth()), *pairs.take(image)):
            image_n, true_n, sensor_n = (
                np.frombuffer(each, "<f4") for each in (shown.pixels, truth.true, truth.sensor)
            )
            yield image_n, true_n, sensor_n


def _late_ns(layout: Layout) -> int:
    """Return the time from SYNC to the image of sums in turns; the images of one instant are judged as if at once."""
    if layout.is_of_one_instant:
        return 0
    contract = Contract.from_layout(layout)
    lines = product(range(len(layout.bus)), range(contract.turns))
    return round(max(random_bus_time(traffic(contract, *each)).cycle_s for each in lines) * 1e9) + LATENESS_NS


def heard(layout: Layout, sent: Frames, seconds: float) -> Frames:
    """Return what a gateway hears of a bus with stepped boards: its own SYNCs among the frames `sent`."""
    syncs = sync_frames(layout, round(seconds * 1000))
    syncs["flags"] |= ECHO
    together: Frames = np.concatenate([syncs, sent])
    return together[np.argsort(together["time_ns"], kind="stable")]


def _steps(layout: Layout, source: TaxelSource, seconds: float) -> Iterator[Moment]:
    """Yield what a receiver knows of the sums of stepped boards at each step of a touch."""
    contract, taxels, rng = Contract.from_layout(layout), layout.taxels, np.random.default_rng(0)
    sums = new_sums(contract)
    receiver = hold((np.ones(layout.blocks, np.bool_), slots_of(contract), contract.parts, sums))
    step_ns, steps, buses = round(1e9 / step_rate_hz(layout)), round(seconds * step_rate_hz(layout)), []
    for bus in range(len(layout.bus)):
        frames = heard(layout, touched_frames(contract, bus, source, seconds), seconds)
        ends = np.searchsorted(frames["time_ns"], np.arange(-1, steps) * step_ns, side="right").tolist()
        buses.append((frames, list(pairwise(ends))))
    walsh = WalshReconstructor(layout.patches(), taxels.rows, taxels.columns, NOISE_N, taxels.surface.graph)
    for step in range(steps):
        for bus, (frames, parts) in enumerate(buses):
            batch = batch_of(frames[slice(*parts[step])], bus, contract.parts)
            take_all(batch, receiver)
        true_n = source.frame(step).force_n.ravel()
        sensor_n = to_counts(sense(true_n, rng, NOISE_N, taxels.force_max_n), taxels) * taxels.newton_per_count
        known = np.concatenate([part[:held] for part, held in zip(sums.known, contract.parts.form[:, 0], strict=True)])
        sums_n = (known * contract.unit_n).astype(np.float32).reshape(layout.blocks, -1)
        yield walsh.solve(sums_n).ravel(), true_n, sensor_n.astype(np.float32)
