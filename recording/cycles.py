"""The sums of every cycle: of a CAN log, decoded by the gateway's loop, or of a recording of forces."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import FrameCounts, Measurement
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import Frames
from gateway.playback import play
from nodes.analogue import AnalogueElectronics
from nodes.electronics import Electronics
from skin.layout import Layout
from skin.measured_sums import used_blocks
from skin.measurement import Sbhe
from touch.sources import recording


@dataclass(frozen=True, eq=False)
class Cycles:
    """Measured cycles of one skin, in the order of time.

    Attributes
    ----------
    counts : array of int32, shape (cycles, m)
        Sums in ADC counts, 0 where invalid.
    valid : array of bool, shape (cycles, blocks)
        True if every sum of the block came in this cycle.
    time_ns : array of int64, shape (cycles,)
        Time of the SYNC: on the clock of the log; of a recording, from 0.
    """

    counts: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]
    time_ns: npt.NDArray[np.int64]


def decode_log(
    contract: Contract, logged: Mapping[int, Frames], advance: Callable[[int], None]
) -> tuple[Cycles, FrameCounts]:
    """Return the cycles of a log, and how its frames were counted.

    See `gateway.playback` for which blocks are valid.

    Parameters
    ----------
    logged : mapping of int to Frames
        Frames by the number of their bus, in the order of the log.
    advance : callable
        Called with the number of further decoded cycles.
    """
    made: list[Measurement] = []
    for part in play(contract, logged):
        made += part.measurements
        advance(len(part.measurements))
    if not made:
        identity = contract.layout.sync.identity
        length = "without data" if identity == "window" else "with a counter, 1 byte"
        raise InputError(
            f'the log holds no SYNC {length} (COB-ID {SYNC_COB_ID:02X}h, sync.identity = "{identity}" of the layout): '
            "it cannot be cut into cycles"
        )
    counts = np.stack([np.frombuffer(each.sums, "<i4") for each in made])
    valid = np.stack([used_blocks(each, contract.phi) for each in made])
    return Cycles(counts, valid, np.array([each.sampled_mono_ns for each in made], np.int64)), part.status.frames


def measure_forces(
    contract: Contract,
    path: Path,
    arrays: Sequence[str] | None,
    full_scale: float | None,
    advance: Callable[[int], None],
) -> Cycles:
    """Measure every frame of a recording of forces in one cycle, with the ADC, Φ and packing of the nodes.

    Every block with sums is valid unless one saturates.

    Parameters
    ----------
    path : pathlib.Path
        ``.npz``, ``.npy`` or ``.csv``, see `touch.reading`. No noise is added: the values contain a sensor's noise.
    arrays : sequence of str, optional
        Arrays of an ``.npz`` to place side by side.
    full_scale : float, optional
        The recorded value that becomes the taxels' largest force; default: the largest value of the recording.
    advance : callable
        Called with the number of further measured frames.
    """
    layout, phi, packing = contract.layout, contract.phi, contract.packing
    taxels = layout.taxels
    source = recording(
        path, taxels.rows, taxels.columns, full_scale=full_scale, force_max_n=taxels.force_max_n, arrays=arrays
    )
    read = _reader(layout, phi)
    counts = np.empty((source.frames, phi.shape[0]), np.int32)
    valid = np.tile(phi.has_sums, (source.frames, 1))
    for step in range(source.frames):
        counts[step] = packing.counts(packing.raw(read(source.frame(step).force_n)))
        usable = packing.usable(counts[step])
        if usable:
            valid[step, phi.block_of_sum[np.frombuffer(usable, np.uint8) == 0]] = False
        advance(1)
    time_ns = np.rint(np.arange(source.frames) * (1e9 * layout.sync.period_s)).astype(np.int64)
    return Cycles(counts, valid, time_ns)


def _reader(layout: Layout, phi: Sbhe) -> Callable[[npt.NDArray[np.float32]], npt.NDArray[np.int32]]:
    """Return what makes sums, counts of shape (m,), of forces of shape (rows, columns)."""
    if layout.taxels.is_analogue:
        boards = AnalogueElectronics(layout, phi, noise_n=0.0)
        return lambda force_n: boards.read_sums(force_n, None, 0)
    electronics = Electronics(layout.taxels, noise_n=0.0, places=phi.wired.taxels)
    return lambda force_n: phi.wired.forward(electronics.read(force_n)).astype(np.int32, copy=False)
