"""Calibration of runs that were recorded without: in the order of their cycles, as the gateway would have done it."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from calibration.calibrator import Calibrator, Tare
from calibration.windows import Bools
from canskin.messages import CycleMeasurement, Measurement
from shell.service import say
from skin.calibration_file import load_calibration
from skin.layout import Layout, require_sending
from skin.phi import Sbhe
from skin.sync_counter import next_counter


def make_calibrator(layout: Layout, path: Path | None, tare: Tare, service: str) -> Calibrator | None:
    """Return what the options ``--calibration`` and ``--tare`` ask for, None for nothing."""
    if path is None and tare == "never":
        return None
    require_sending(layout, "synchronous", "--calibration and --tare are", "stepped boards have their own zero")
    offsets_n = load_calibration(path, layout).required_offsets_n(str(path)) if path is not None else None
    return Calibrator(layout, offsets_n=offsets_n, tares=tare == "at-start", say=lambda text: say(service, text))


def calibrated(measurements: Iterable[Measurement], calibrator: Calibrator | None) -> Iterator[Measurement]:
    """Yield measurements with offsets; without a calibrator, as they are."""
    for each in measurements:
        if calibrator is None:
            yield each
            continue
        yield calibrator.apply(each)
        calibrator.take(each)
        calibrator.work()


def measurement_of(
    layout: Layout,
    phi: Sbhe,
    cycle: int,
    counts: npt.NDArray[np.int32],
    valid: Bools | None = None,
    *,
    time_ns: int | None = None,
) -> Measurement:
    """Return the measurement of a cycle, counted from 0, of sums of shape (m,); `phi` is the Φ of `layout`.

    By default all blocks are valid, and the time is that of `cycle` + 1 periods.
    """
    if time_ns is None:
        time_ns = round((cycle + 1) * layout.sync.period_s * 1e9)
    whole = np.ones(layout.blocks, np.uint8) if valid is None else valid.astype(np.uint8)
    return CycleMeasurement(
        cycle=cycle + 1,
        sync_counter=next_counter(cycle),
        sampled_mono_ns=time_ns,
        sums=counts.astype("<i4").tobytes(),
        valid=whole.tobytes(),
        fingerprint=phi.fingerprint,
    )
