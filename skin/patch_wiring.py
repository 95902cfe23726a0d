"""Where the taxels of a block are, and how long the wire is that joins them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from canskin.errors import LayoutError
from skin.phi import Sbhe
from skin.walsh import Indices, dealt


def check_patch(  # noqa: PLR0917
    rows: int, columns: int, block_size: int, wiring: str, patch: int | None, has_gaps: bool = False
) -> None:
    """Check ``measurement.patch`` of a layout."""
    if patch is None:
        return
    problem = None
    if wiring != "scattered":
        problem = f"patch needs wiring = 'scattered', got '{wiring}'"
    elif patch > min(rows, columns):
        problem = f"expected {min(rows, columns)} or less on a grid of {rows} x {columns} taxels, got {patch}"
    elif has_gaps:
        problem = f"a grid with gaps has no regions of {patch} x {patch}: leave the key out"
    elif rows % patch or columns % patch:
        problem = f"{rows} x {columns} taxels do not divide into regions of {patch} x {patch}"
    elif patch**2 < block_size:
        problem = f"{patch} x {patch} taxels are fewer than the {block_size} of a block: got {patch}"
    if problem:
        raise LayoutError(f"{problem} - at `$.measurement.patch`")


def within_patches(phi: Sbhe, rows: int, columns: int, patch: int, blocks: Sequence[int]) -> Sbhe:
    """Return Φ with every block inside a region of `patch` x `patch` taxels, with the same selected rows.

    The taxels of a region follow each other as in the given Φ, so the seed of Φ scatters them. The blocks of a region
    are on as many buses as possible, and a touch meets all buses alike.

    Parameters
    ----------
    phi : Sbhe
        Scattered over the whole grid.
    rows, columns : int
        The grid, multiples of `patch`.
    patch : int
        Side of a region, taxels.
    blocks : sequence of int
        Number of blocks of each bus.
    """
    place = np.argsort(phi.order)
    grid = np.arange(rows * columns).reshape(rows // patch, patch, columns // patch, patch)
    regions = grid.swapaxes(1, 2).reshape(-1, patch * patch)
    scattered = np.take_along_axis(regions, np.argsort(place[regions], axis=1), axis=1)
    region, member = np.indices((len(regions), patch * patch // phi.block_size))
    bus = dealt((region + member).ravel() % len(blocks), blocks)
    chains = scattered.reshape(-1, phi.block_size)[np.argsort(bus, kind="stable")]
    return replace(phi, order=chains.ravel().astype(np.intp))


def chain_lengths_m(chains: Indices, positions_m: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the length of each block's wire in metres, shape (blocks,).

    The wire begins at the first taxel of the block and always goes on to the nearest taxel that is left. Such a chain
    is not the shortest. The order of the wire has no effect on Φ: the board knows the sign of each taxel.

    Parameters
    ----------
    chains : array of int, shape (blocks, block size)
        Taxels (`Sbhe.taxels_of_blocks`); empty places need no wire.
    positions_m : array, shape (n, 3)
        Of the taxels, metres.
    """
    places = positions_m[np.where(chains < len(positions_m), chains, chains.min(axis=1, keepdims=True))]
    # To the nanometre: taxels that are as far away are taken in their order, whatever the last bits.
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=-1).round(9)
    blocks, here = np.arange(len(chains)), np.zeros(len(chains), np.intp)
    length = np.zeros(len(chains))
    for _ in range(chains.shape[1] - 1):
        apart[blocks, :, here] = np.inf  # the wire never comes back
        nearest = apart[blocks, here].argmin(axis=1)
        length += apart[blocks, here, nearest]
        here = nearest
    return length
