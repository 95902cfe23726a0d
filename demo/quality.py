"""How good the images of a skin are with several numbers of sums: simulated touches, its nodes, its solver."""

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import msgspec
import numpy as np

from canskin.errors import LayoutError, RunError
from demo.chain import REST_S, Nodes
from reconstructor.imaging import CycleImager
from skin.ground_truth import in_contact
from skin.layout import Layout, require_sending, validated
from skin.measured_sums import decode_measurement
from skin.psnr import decibels
from skin.sources import load_objects, step_rate_hz

#: Time of the simulated touches: each of the five default objects touches.
TOUCHES_S: Final = 12.0
#: Taxels per sum that are tried.
TAXELS_PER_SUM: Final = (16, 8, 4, 2, 1)
#: The constant of the paper's m ≥ 0.28 k log(p / k) (section III).
BOUND: Final = 0.28


class Quality(NamedTuple):
    """What one number of sums gives.

    Attributes
    ----------
    sums : int
    sums_per_taxel : float
    psnr_image_db, psnr_sensor_db : float
        Means over the cycles in contact, of the image and of the sensor's own signal.
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


def qualities(layout: Layout, *, touches_s: float = TOUCHES_S, seed: int = 0) -> list[Quality]:
    """Return the quality of a layout with one sum for each of `TAXELS_PER_SUM` places, fewest sums first.

    Raises
    ------
    InputError
        If the layout does not send sums in cycles: adaptive boards send all sums.
    RunError
        If no object touches in `touches_s`.
    """
    require_sending(layout, "synchronous", "the quality by the number of sums is", "adaptive boards send all sums")
    return [_quality(each, touches_s, seed) for each in _layouts(layout)]


def _layouts(layout: Layout) -> Iterator[Layout]:
    """Yield the layout with other numbers of sums in every cycle, of drawn rows; a matrix as it is."""
    if layout.measurement.matrix is not None:
        yield layout
        return
    for each in TAXELS_PER_SUM:
        measurement = msgspec.structs.replace(
            layout.measurement, sums=layout.places // each, rows=None, selection="balanced"
        )
        try:
            yield validated(msgspec.structs.replace(layout, measurement=measurement, recognition=None))
        except LayoutError:  # such sums cannot be shared evenly by the blocks
            continue


def _quality(layout: Layout, touches_s: float, seed: int) -> Quality:
    taxels, phi, imager = layout.taxels, layout.operator(), CycleImager(layout)
    nodes = Nodes(layout, load_objects(layout, seed=seed, rest_s=REST_S), seed=seed)
    imaged_n2, sensed_n2, touched_n2, touched = [], [], 0.0, []
    for _ in range(round((REST_S + touches_s) * step_rate_hz(layout))):
        measurement = nodes.measurement(nodes.sample())
        image_n = imager.solve(decode_measurement(measurement, phi))[0].ravel()
        truth = nodes.truth()
        true_n, sensor_n = (np.frombuffer(each, "<f4") for each in (truth.true, truth.sensor))
        if not in_contact(true_n, taxels.force_max_n):
            continue
        error_n = (image_n - true_n)[phi.is_wired]
        imaged_n2.append(float(np.mean(error_n**2)))
        sensed_n2.append(float(np.mean((sensor_n - true_n)[phi.is_wired] ** 2)))
        is_touched = true_n[phi.is_wired] > 0
        touched_n2 += float((error_n[is_touched] ** 2).sum())
        touched.append(int(is_touched.sum()))
    if not touched:
        raise RunError(f"nothing touched '{layout.name}' within {touches_s:g} s: expected a longer time")
    bounds = [BOUND * count * math.log(taxels.there / count) for count in touched]
    return Quality(
        sums=phi.shape[0],
        sums_per_taxel=phi.shape[0] / taxels.there,
        psnr_image_db=float(decibels(imaged_n2, taxels.force_max_n).mean()),
        psnr_sensor_db=float(decibels(sensed_n2, taxels.force_max_n).mean()),
        touched_error_n=math.sqrt(touched_n2 / sum(touched)),
        bound_sums=float(np.median(bounds)),
    )
