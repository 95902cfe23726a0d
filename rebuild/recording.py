"""A recording of forces, measured as in the nodes: the same ADC, Φ and packing of the sums."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from dbc.contract import Contract
from nodes.electronics import Electronics
from rebuild.cycles import Cycles
from touch.sources import recording


def measure_recording(
    contract: Contract,
    path: Path,
    arrays: Sequence[str] | None,
    full_scale: float | None,
    advance: Callable[[int], None],
) -> Cycles:
    """Measure every frame of a recording in one cycle of the skin; every block with sums is valid.

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
    electronics = Electronics(taxels, noise_n=0.0)
    counts = np.empty((source.frames, phi.shape[0]), np.int32)
    for step in range(source.frames):
        sums = phi.forward(electronics.read(source.frame(step).force_n)).astype(np.int32, copy=False)
        counts[step] = packing.counts(packing.raw(sums))
        advance(1)
    time_ns = np.rint(np.arange(source.frames) * (1e9 * layout.sync.period_s)).astype(np.int64)
    return Cycles(counts, np.tile(phi.has_sums, (source.frames, 1)), time_ns)
