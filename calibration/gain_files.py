"""Gains from files: a recording of a rolled weight, or a table."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from calibration.gains import defects_of, find_gains
from calibration.windows import Floats
from canskin.errors import InputError, RunError
from canskin.messages import IMAGE, MEASUREMENT
from recording import RECORDING_SUFFIX, is_recording
from recording.mcap_file import read_messages
from shell.service import say
from skin.calibration_file import LEAST_GAIN, MOST_GAIN, StoredCalibration, load_calibration, new_calibration
from skin.frontend import LEAST_FELT
from skin.layout import Layout, require_sending
from skin.measured_sums import decode_measurement
from skin.ranges import require_above_zero
from skin.text_tables import read_numbers


def stored_gains(skin: Layout, path: Path, force_n: float | None, before: Path | None = None) -> StoredCalibration:
    """Return the gains in a table (.csv), or those that a recording of a rolled weight tells.

    Parameters
    ----------
    force_n : float or None
        The force of the weight; None for a table.
    before : pathlib.Path, optional
        Calibration with the gains that the nodes took off during the roll; default: those in the recording.

    Raises
    ------
    RunError
        If the recording has no complete cycle with its image.
    """
    taxels = skin.taxels
    if path.suffix.lower() == ".csv":
        if force_n is not None or before is not None:
            raise InputError("--force-n and --before are for a recording: a .csv holds the gains themselves")
        table = read_numbers(path, InputError, "a table of gains")
        if table.shape != (taxels.rows, taxels.columns) or not ((table >= LEAST_GAIN) & (table <= MOST_GAIN)).all():
            raise InputError(
                f"{path}: expected {taxels.rows} lines of {taxels.columns} gains from {LEAST_GAIN:g} to {MOST_GAIN:g}"
            )
        return new_calibration(skin, gains=table.ravel())
    if not is_recording(path):
        raise InputError(f"{path}: expected a recording ({RECORDING_SUFFIX}), or a table of gains (.csv)")
    if force_n is None:
        raise InputError("expected the force of the weight: --force-n NEWTONS")
    require_above_zero("--force-n", force_n, taxels.force_max_n * taxels.count)
    if taxels.is_analogue and before is not None:
        raise InputError("--before is for nodes that take off gains: boards that make sums in hardware take off none")
    require_sending(skin, "synchronous", "a recording of a rolled weight is", "expected a table of gains (.csv)")
    sums_n, images_n = _rolled(skin, path)
    found = find_gains(skin.phi(), taxels.surface, sums_n, images_n, force_n, is_analogue=taxels.is_analogue)
    known = found.gains[found.known]
    say("calibration", f"{found.cycles} cycles; gains of {known.size} of {taxels.count} taxels, others stay 1")
    # What feels next to nothing is no matter of gain: a node would make its noise a force.
    gains = np.where(found.gains < LEAST_FELT, 1.0, found.gains)
    words = defects_of(found, skin.phi(), taxels.surface)
    if found.sums is not None:
        say("calibration", f"gains of {sums_n.shape[1]} sums")
        return new_calibration(skin, gains=gains, sum_gains=found.sums, defects=words)
    return new_calibration(skin, gains=gains * _gains_before(skin, path, before), defects=words)


def _gains_before(skin: Layout, path: Path, before: Path | None) -> Floats:
    """Return the gains that the nodes took off while a weight was rolled, shape (n,); 1 if nothing tells them."""
    gains = load_calibration(before or path, skin).gains
    if gains:
        say("calibration", f"times the gains that the nodes took off meanwhile, of {(before or path).name}")
        return np.array(gains)
    if before is not None:
        raise InputError(f"{before}: has no gains of taxels: expected a file of 'skin calibration gain'")
    say("calibration", "the gateway knew no gains of the nodes: taken as 1; name others with --before FILE")
    return np.ones(skin.taxels.count)


def _rolled(skin: Layout, path: Path) -> tuple[Floats, npt.NDArray[np.float32]]:
    """Return the sums and images of the complete cycles of a recording, newtons."""
    phi, taxels = skin.phi(), skin.taxels
    measured: dict[tuple[int, int], npt.NDArray[np.int32]] = {}
    images: dict[tuple[int, int], bytes] = {}
    has_zero = True
    for topic, _, message in read_messages(path, (MEASUREMENT, IMAGE), lambda line: say("calibration", line)):
        key = message.cycle, message.sampled_mono_ns  # a gateway that starts again counts cycles from 1 again
        if topic is IMAGE:
            images[key] = message.pixels
            continue
        sums = decode_measurement(message, phi)
        if sums.valid_sums.all():
            if message.offsets:
                measured[key] = sums.counts
            else:
                has_zero = False
    both = sorted(measured.keys() & images.keys())
    if not both and not has_zero:
        raise InputError(f"{path}: its measurements have no offsets: record while the gateway follows the zero")
    if not both:
        raise RunError(f"{path}: no complete cycle with its image: play frames alone with 'skin replay --out' first")
    sums_n = np.stack([measured[each] for each in both]).astype(np.float64) * taxels.newton_per_count
    pixels: npt.NDArray[np.float32] = np.stack([np.frombuffer(images[each], "<f4") for each in both])
    return sums_n, pixels
