"""Gains from files: a recording of a rolled weight, or a table."""

from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from calibration.gains import defects_of, find_gains
from calibration.stored import LEAST_GAIN, MOST_GAIN, StoredCalibration, store
from calibration.windows import Floats
from skin.errors import InputError, RunError
from skin.layout import Layout
from skin.mcap_file import read_entries
from skin.measured_sums import decode_measurement
from skin.messages import IMAGE, MEASUREMENT, Image, Measurement
from skin.output import RECORDING_SUFFIX
from skin.service import say


def stored_gains(skin: Layout, path: Path, force_n: float | None) -> StoredCalibration:
    """Return the gains in a table (.csv), or those that a recording of a rolled weight tells.

    Parameters
    ----------
    skin : Layout
    path : pathlib.Path
    force_n : float or None
        The force of the weight; None for a table.

    Raises
    ------
    InputError
        If the file cannot be used.
    RunError
        If the recording has no complete cycle with its image.
    """
    taxels = skin.taxels
    if path.suffix.lower() == ".csv":
        if force_n is not None:
            raise InputError("--force-n is for a recording: a .csv holds the gains themselves")
        try:
            table = np.loadtxt(path, np.float64, delimiter=",", ndmin=2)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot read a table of gains: {error}") from error
        if table.shape != (taxels.rows, taxels.columns) or not ((table >= LEAST_GAIN) & (table <= MOST_GAIN)).all():
            raise InputError(
                f"{path}: expected {taxels.rows} lines of {taxels.columns} gains from {LEAST_GAIN:g} to {MOST_GAIN:g}"
            )
        return store(skin, gains=table.ravel())
    if path.suffix.lower() != RECORDING_SUFFIX:
        raise InputError(f"{path}: expected a recording ({RECORDING_SUFFIX}), or a table of gains (.csv)")
    if force_n is None:
        raise InputError("expected the force of the weight: --force-n NEWTONS")
    if skin.sending == "adaptive":
        raise InputError("gains are found in the sums of synchronous layouts")
    sums_n, images_n = _rolled(skin, path)
    found = find_gains(skin.phi(), sums_n, images_n, force_n)
    known = found.gains[found.known]
    say("calibration", f"{found.cycles} cycles; gains of {known.size} of {taxels.count} taxels, others stay 1")
    return store(skin, gains=found.gains, defects=defects_of(found, taxels.columns))


def _rolled(skin: Layout, path: Path) -> tuple[Floats, npt.NDArray[np.float32]]:
    """Return the sums and images of the complete cycles of a recording, newtons."""
    phi, taxels = skin.phi(), skin.taxels
    measurements: dict[int, npt.NDArray[np.int32]] = {}
    images: dict[int, bytes] = {}
    for entry in read_entries(path, lambda line: say("calibration", line)):
        if entry.topic == MEASUREMENT.name:
            measurement = msgspec.msgpack.decode(entry.data, type=Measurement)
            sums = decode_measurement(measurement, phi)
            if sums.valid_sums.all():
                measurements[measurement.cycle] = sums.counts
        elif entry.topic == IMAGE.name:
            image = msgspec.msgpack.decode(entry.data, type=Image)
            images[image.cycle] = image.pixels
    both = sorted(measurements.keys() & images.keys())
    if not both:
        raise RunError(f"{path}: no complete cycle with its image: play frames alone with 'skin replay --out' first")
    shape = (taxels.rows, taxels.columns)
    counts = np.stack([measurements[cycle] for cycle in both])
    return counts * taxels.newton_per_count, np.stack(
        [np.frombuffer(images[each], "<f4").reshape(shape) for each in both]
    )
