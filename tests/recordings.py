"""Short recordings of touches, of measurements, contacts and marks alone."""

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np

from canskin.messages import CONTACTS, MARK, MEASUREMENT, Mark
from classifier.samples import simulate_sums
from dbc.contract import Contract
from recording.sinks import McapSink
from skin.layout import Layout
from tests import messages as make

START_NS = 1_700_000_000_000_000_000
#: Cycles before each touch, and of each touch.
REST, HOLD = 16, 6


def write_touches(
    path: Path,
    layout: Layout,
    force_n: np.ndarray,
    labels: Sequence[str] | np.ndarray,
    *,
    seed: int = 0,
    rest: int = REST,
    hold: int = HOLD,
    lost_block: int | None = None,
) -> Path:
    """Write touches one after the other: `rest` cycles without touch, then `hold` cycles with the force.

    Parameters
    ----------
    force_n : array of float32, shape (count, rows, columns)
    labels : sequence of str
        A mark is set a cycle before each touch; "-" sets none.
    lost_block : int, optional
        A block that is never valid.
    """
    phi, rng = layout.phi(), np.random.default_rng(seed)
    period_ns = round(layout.sync.period_s * 1e9)
    sink = McapSink(path, Contract.from_layout(layout), START_NS, START_NS)
    valid = phi.has_sums.copy()
    if lost_block is not None:
        valid[lost_block] = False
    cycle = 0
    for touch, label in zip(force_n, labels, strict=True):
        forces = np.concatenate([np.zeros((rest, *touch.shape), np.float32), np.repeat(touch[None], hold, axis=0)])
        for place, sums in enumerate(simulate_sums(forces, layout, phi, 0.001, rng)):
            cycle += 1
            stamps = {"sampled_mono_ns": cycle * period_ns}
            time_ns = START_NS + cycle * period_ns
            if place == rest - 1 and label != "-":
                sink.message(MARK, time_ns, msgspec.msgpack.encode(Mark(label=str(label))))
            counts = np.where(phi.sums_of_blocks(valid), sums, 0).astype("<i4")
            whole = {"sums": counts.tobytes(), "valid": valid.tobytes(), "fingerprint": phi.fingerprint}
            contacts = [make.contact(force_n=float(touch.sum()), taxels=int((touch > 0).sum()))] * (place >= rest)
            if layout.sends.in_cycles:
                sent = make.measurement(cycle, **stamps, **whole)
            else:
                sent = make.stepped_measurement(forces[place], layout=layout, cycle=cycle, **stamps)
            for topic, message in ((MEASUREMENT, sent), (CONTACTS, make.contacts(cycle, *contacts, **stamps))):
                sink.message(topic, time_ns, msgspec.msgpack.encode(message))
    sink.close()
    return path
