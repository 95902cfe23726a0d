"""What one board computes: counts of its taxels, corrected or replaced by a test pattern, to sums and payloads.

The words for the same are in ``docs/firmware.md``. Virtual nodes compute whole skins at once, in `nodes`.
"""

import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from dbc import indices as od
from dbc.codec import encode
from dbc.configuration import calibration, configuration, signature, with_calibration
from dbc.contract import Contract, NodeContract
from skin.phi import fast_hadamard
from skin.taxel import corrected

#: Test patterns (2021h): measured counts; 0; the place in the chain; full scale.
PATTERN_OFF, PATTERN_ZERO, PATTERN_RAMP, PATTERN_FULL = range(4)


def pattern_counts(pattern: int, size: int, count_max: int) -> npt.NDArray[np.int32] | None:
    """Return what a test pattern shows in place of `size` taxels, in counts; None for `PATTERN_OFF`.

    The ramp ends at full scale, where a chain has more places than the taxels have counts.
    """
    if pattern == PATTERN_OFF:
        return None
    if pattern == PATTERN_RAMP:
        return np.minimum(np.arange(size, dtype=np.int32), np.int32(count_max))
    return np.full(size, count_max if pattern == PATTERN_FULL else 0, np.int32)


def shown_counts(
    contract: Contract,
    counts: npt.NDArray[Any],
    gain: npt.NDArray[np.float32],
    offset: npt.NDArray[np.float32],
    patterns: npt.NDArray[np.integer],
) -> npt.NDArray[np.float32]:
    """Return the values of which a board makes its sums.

    Parameters
    ----------
    counts, gain, offset : array, shape (blocks, block size)
        In chain order. `counts` holds ADC counts or, with more than one sample in a cycle, averages.
    patterns : array of int, shape (blocks,)

    Returns
    -------
    array of float32, shape (blocks, block size)
        Whole numbers where a cycle has one sample.
    """
    taxels = contract.layout.taxels
    shown = corrected(counts, gain, offset, taxels)
    if contract.layout.samples_per_sync == 1:
        np.rint(shown, out=shown)
    for row, pattern in enumerate(patterns):
        replaced = pattern_counts(int(pattern), shown.shape[1], taxels.count_max)
        if replaced is not None:
            shown[row] = replaced
    return shown


def calibration_values(
    gain: npt.NDArray[np.float32], offset: npt.NDArray[Any], pattern: int
) -> dict[tuple[int, int], bytes]:
    """Return the objects of gains, offsets and a test pattern, as the bytes of an SDO transfer by index and sub-index.

    Parameters
    ----------
    gain, offset : array, shape (blocks, block size)
        2010h and 2011h, in chain order.
    pattern : int
        2021h of all blocks.
    """
    values = {(od.of_block(od.TEST_PATTERN, place), 0): bytes((pattern,)) for place in range(len(gain))}
    for (place, at), value in np.ndenumerate(gain):
        values[od.of_block(od.GAIN, place), at + 1] = struct.pack("<f", value)
        values[od.of_block(od.OFFSET, place), at + 1] = struct.pack("<h", int(offset[place, at]))
    return values


def calibration_signature(contract: Contract, node: NodeContract, values: Mapping[tuple[int, int], bytes]) -> int:
    """Return 2009h of a board with these `values`, where all other objects are those of the contract."""
    covered = with_calibration(configuration(contract, node), calibration(contract, node))
    return signature(
        (each.index, each.subindex, values.get((each.index, each.subindex), each.data)) for each in covered
    )


def node_sums(contract: Contract, node: NodeContract, shown: npt.NDArray[np.float32]) -> npt.NDArray[np.int32]:
    """Return the sums of a board, shape (node.sums,), of values of shape (blocks, block size).

    Of an analogue front end: what its converters would read of taxels with these values.
    """
    kept = contract.phi.kept[node.block : node.block + node.blocks]
    sums = np.asarray(fast_hadamard(shown), np.float32)[kept]
    of_sums = contract.packing.converter
    if of_sums is not None:
        return of_sums.rounded(sums)
    return np.rint(sums).astype(np.int32)


def node_payloads(
    contract: Contract, node: NodeContract, sync_counter: int, sums: npt.NDArray[np.int32]
) -> dict[int, bytes]:
    """Return the payload of each TPDO of a synchronous board by its COB-ID, whatever its turn, padding included."""
    table, first = contract.table, int(contract.phi.starts[node.block])
    rows = np.nonzero((table.bus == node.bus) & (table.node == contract.nodes.index(node)))[0]
    gather = np.where(table.gather[rows] >= 0, table.gather[rows] - first, -1)
    packed = encode(sync_counter, sums, gather, contract.packing)
    payloads = {}
    for row, payload in zip(rows, packed, strict=True):
        length = int(table.length[row])
        payloads[int(table.cob_id[row])] = payload.tobytes()[:length].ljust(length, b"\0")
    return payloads
