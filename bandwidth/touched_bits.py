"""Mean length of the frames of a touched skin: sums of simulated touches, with exact stuff bits.

Sums are not random bits. Sums of an untouched skin are small, and in two's complement a small number is a run of equal
bits, which needs stuff bits.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.codec import encode
from dbc.contract import Contract
from dbc.frame import frames
from dbc.frame_bits import wire_bits
from skin.frontend import converter
from skin.sources import TaxelSource, load_objects
from skin.sync_counter import SYNC_OVERFLOW
from skin.taxel import NOISE_N, sense, to_counts

#: Number of steps, and distance between them: several touches of every object, each at another place.
SAMPLES: Final = 400
STRIDE_S: Final = 0.137


def touched_bits(contract: Contract) -> npt.NDArray[np.float64]:
    """Return the mean bits of all TPDOs of one cycle of touches, shape (buses, turns, 2): nominal and data."""
    layout, table = contract.layout, contract.table
    source = load_objects(layout)
    random = np.random.default_rng(0)
    burst = frames(len(table.cob_id))
    burst["can_id"], burst["length"], burst["flags"] = table.cob_id, table.length, table.flags
    total = np.zeros((len(layout.bus), contract.turns, 2))
    stride = max(1, round(STRIDE_S * layout.sync.rate_hz))
    for sample in range(SAMPLES):
        counter = 1 + sample % SYNC_OVERFLOW
        payloads = encode(counter, _sums(contract, source, sample * stride, random), table.gather, contract.packing)
        burst["data"][:, : payloads.shape[1]] = payloads
        np.add.at(total, (table.bus, table.turn), np.stack(wire_bits(burst), axis=1))
    mean: npt.NDArray[np.float64] = total / SAMPLES
    return mean


def _sums(contract: Contract, source: TaxelSource, step: int, random: np.random.Generator) -> npt.NDArray[np.int32]:
    """Return the sums of the nodes in ADC counts: noise, clipping, rounding; an analogue front end clips no taxel."""
    taxels, phi = contract.layout.taxels, contract.phi
    noise_n = 0.0 if source.has_noise else NOISE_N
    force_n = source.frame(step).force_n.ravel()
    of_sums = converter(contract.layout)
    if of_sums is not None:
        return of_sums.counts(np.asarray(phi.forward(force_n + random.normal(0.0, noise_n, force_n.shape)), np.float64))
    counts = to_counts(sense(force_n, random, noise_n, taxels.force_max_n, dtype=np.float64), taxels)
    return np.asarray(phi.forward(counts), np.int32)  # more than 16 bits before they are packed
