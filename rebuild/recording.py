"""A recording of forces, measured as in the nodes: the same ADC, Φ and packing of the sums."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dbc.contract import Contract
from nodes.analogue import AnalogueElectronics
from nodes.electronics import Electronics
from rebuild.cycles import Cycles
from skin.layout import Layout
from skin.measurement import Sbhe
from touch.sources import recording


def measure_recording(
    contract: Contract,
    path: Path,
    arrays: Sequence[str] | None,
    full_scale: float | None,
    advance: Callable[[int], None],
) -> Cycles:
    """Measure every frame of a recording in one cycle of the skin; every block with sums is valid unless one saturates.

    Parameters
    ----------
    contract : Contract
    path : pathlib.Path
        ``.npz``, ``.npy`` or ``.csv``, see `touch.reading`. No noise is added: the values contain a sensor's noise.
    arrays : sequence of str, optional
        Arrays of an ``.npz`` to place side by side.
    full_scale : float, optional
        The recorded value that becomes the taxels' largest force; default: the largest value of the recording.
    advance : callable
        Called with the number of further measured frames.

    Raises
    ------
    InputError
        If the recording cannot be used.
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
    electronics = Electronics(layout.taxels, noise_n=0.0)
    return lambda force_n: phi.forward(electronics.read(force_n)).astype(np.int32, copy=False)
