"""The measurement operator Φ: what the services need of any, and a scrambled block Hadamard ensemble (SBHE).

SBHE: Φ = Q W P (section V of the paper, after Gan, Do and Tran 2008): P permutes the n taxels, W is block
diagonal with B x B Hadamard matrices of ±1, Q selects m of its n rows. Every sum is over the B taxels of one block,
so the board of the block can compute it. W W^T = B I, hence Φ Φ^T = B I exactly.
"""

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.operator import check_vectors

Selection = Literal["balanced", "uniform"]
Array = TypeVar("Array", bound=npt.NDArray[np.generic])


def fast_hadamard(blocks: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    """Multiply the last axis by the Sylvester-ordered Hadamard matrix of ±1, in B log2 B additions.

    Parameters
    ----------
    blocks : array, shape (..., B)
        B a power of two. Integers stay exact: choose a dtype that holds B times the largest value.

    Returns
    -------
    array of the same shape and dtype
    """
    size = blocks.shape[-1]
    lead = blocks.shape[:-1]
    work, half = blocks, 1
    while half < size:
        pairs = work.reshape(*lead, size // (2 * half), 2, half)
        first, second = pairs[..., 0, :], pairs[..., 1, :]
        work = np.stack((first + second, first - second), axis=-2)  # type: ignore[operator]  # any number dtype
        half *= 2
    return work.reshape(blocks.shape)


class Phi(ABC):
    """Φ of one skin, y = Φ x, as the services behind the fabric need it: a `skin.operator.Operator` with blocks.

    The sums of a block come and get lost together. Where Φ changes from frame to frame, `of_cycle` has that of each.
    """

    @property
    @abstractmethod
    def shape(self) -> tuple[int, int]:
        """(m, n): sums and taxels, gaps included."""

    @property
    @abstractmethod
    def blocks(self) -> int:
        """Number of blocks."""

    @property
    @abstractmethod
    def block_of_sum(self) -> npt.NDArray[np.intp]:
        """Block of every sum, shape (m,), ascending."""

    @property
    @abstractmethod
    def is_wired(self) -> npt.NDArray[np.bool_]:
        """Which taxels there are, shape (n,); the others are gaps."""

    @property
    @abstractmethod
    def norm_squared(self) -> float:
        """Upper bound of the eigenvalues of ΦᵀΦ, the largest of them but for rounding and empty places."""

    @property
    @abstractmethod
    def fingerprint(self) -> str:
        """16 hex digits that differ whenever any entry of Φ differs."""

    @abstractmethod
    def forward(self, x: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return y = Φ x, shape (..., m), of taxels (..., n)."""

    @abstractmethod
    def adjoint(self, y: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return Φᵀ y, shape (..., n), of sums (..., m)."""

    @abstractmethod
    def valid_taxels(self, valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Tell which taxels were measured, shape (n,), by which blocks are valid, shape (blocks,)."""

    @property
    def frames(self) -> int:
        """Number of cycles after which Φ repeats: 1 if it does not change."""
        return 1

    def of_cycle(self, cycle: int) -> "Phi":
        """Return the Φ of a cycle; cycles are numbered from 1."""
        del cycle
        return self

    @cached_property
    def starts(self) -> npt.NDArray[np.intp]:
        """Index in y of the first sum of each block, shape (blocks + 1,)."""
        return np.searchsorted(self.block_of_sum, np.arange(self.blocks + 1)).astype(np.intp)

    @cached_property
    def has_sums(self) -> npt.NDArray[np.bool_]:
        """Whether a block sends any sum, shape (blocks,); a block without sums is never valid."""
        return np.asarray(np.diff(self.starts) > 0, np.bool_)

    def sums_of_blocks(self, valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Spread one validity per block, shape (blocks,), to one per sum, shape (m,)."""
        if valid.shape != (self.blocks,) or valid.dtype != np.bool_:
            raise InputError(f"expected {self.blocks} booleans, one a block, got {valid.dtype} of shape {valid.shape}")
        return valid[self.block_of_sum]

    def total_of_blocks(
        self, values: npt.NDArray[np.bool_ | np.integer[Any] | np.floating[Any]]
    ) -> npt.NDArray[np.float64]:
        """Return the total of one value per sum, shape (m,), over each block, shape (blocks,)."""
        return np.bincount(self.block_of_sum, values, self.blocks).astype(np.float64, copy=False)

    def all_of_blocks(self, flags: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Tell of which blocks every sum has its flag set; `flags` has shape (m,). A block without sums has all set."""
        return np.asarray(self.total_of_blocks(~flags) == 0, np.bool_)


@dataclass(frozen=True, eq=False)
class Sbhe(Phi):
    """Φ of one skin: y = Φ x, shape (m, n), entries 0 and ±1.

    Sums are ordered by block, and inside a block by Hadamard row. Where the taxels do not fill the blocks, some places
    are empty: they count as taxels that read 0, and are numbered after the taxels. A taxel that no block has is a gap:
    no sum feels it.

    Attributes
    ----------
    order : array of int, shape (blocks * block_size,)
        Permutation P: the taxel at place r of block b is ``order[b * block_size + r]`` (row-major index); from n on,
        an empty place.
    kept : array of bool, shape (blocks, block_size)
        Selection Q: which Hadamard rows of each block are sent.
    taxels : int
        n, gaps included.
    """

    order: npt.NDArray[np.intp]
    kept: npt.NDArray[np.bool_]
    taxels: int

    @property
    def block_size(self) -> int:
        """Taxels per block B, also the only non-zero eigenvalue of ΦᵀΦ."""
        return int(self.kept.shape[1])

    @property
    def blocks(self) -> int:
        """Number of blocks, n / B, rounded up."""
        return int(self.kept.shape[0])

    @cached_property
    def shape(self) -> tuple[int, int]:
        """(m, n): sums and taxels."""
        return int(self.kept.sum()), self.taxels

    @cached_property
    def empty(self) -> int:
        """Number of empty places."""
        return int((self.order >= self.taxels).sum())

    @cached_property
    def is_wired(self) -> npt.NDArray[np.bool_]:
        """Which taxels a block has, shape (n,); the others are gaps."""
        return np.asarray(self.block_of_taxel < self.blocks, np.bool_)

    @cached_property
    def place_of_taxel(self) -> npt.NDArray[np.intp]:
        """Place of every taxel, shape (n,): that of block b are those from b * block_size on; of a gap 0."""
        return self._numbered(np.arange(self.order.size), 0)

    @property
    def norm_squared(self) -> float:
        """Largest eigenvalue of ΦᵀΦ: B; with empty places at most B."""
        return float(self.block_size)

    @cached_property
    def block_of_sum(self) -> npt.NDArray[np.intp]:
        """Block of every sum, shape (m,)."""
        return np.nonzero(self.kept)[0]

    @cached_property
    def row_of_sum(self) -> npt.NDArray[np.intp]:
        """Hadamard row of every sum inside its block, shape (m,)."""
        return np.nonzero(self.kept)[1]

    @cached_property
    def held(self) -> npt.NDArray[np.intp]:
        """Number of taxels of every block, without empty places, shape (blocks,)."""
        return np.asarray((self.taxels_of_blocks < self.taxels).sum(axis=1), np.intp)

    @property
    def taxels_of_blocks(self) -> npt.NDArray[np.intp]:
        """Taxels of every block in the order of its chain, and empty places, shape (blocks, block_size)."""
        return self.order.reshape(self.kept.shape)

    def taxels_of(self, block: int) -> npt.NDArray[np.intp]:
        """Return the taxels of a block in the order of its chain, without empty places."""
        chain = self.taxels_of_blocks[block]
        return np.compress(chain < self.shape[1], chain)

    @cached_property
    def wired(self) -> "Sbhe":
        """The same Φ with empty places as taxels, shape (m, n + empty): what the converters of the boards read."""
        return replace(self, taxels=self.taxels + self.empty)

    @cached_property
    def _sending_taxels(self) -> npt.NDArray[np.intp]:
        """Taxels of the blocks that send sums."""
        return self.taxels_of_blocks[self.has_sums]

    @cached_property
    def _sent(self) -> npt.NDArray[np.bool_]:
        """Hadamard rows that are sent, of the blocks that send sums."""
        return self.kept[self.has_sums]

    @cached_property
    def _signs(self) -> npt.NDArray[np.int8] | None:
        """Signs of the taxels of the blocks that send sums, shape (m, block_size), where none sends two."""
        if self.shape[0] != self.has_sums.sum():
            return None
        rows = fast_hadamard(np.eye(self.block_size, dtype=np.int8))
        return np.asarray(rows[self.row_of_sum], np.int8)

    @cached_property
    def block_of_taxel(self) -> npt.NDArray[np.intp]:
        """Block of every taxel, shape (n,); of a gap the number of blocks."""
        return self._numbered(np.arange(self.order.size) // self.block_size, self.blocks)

    def of_taxels(self, of_blocks: Array) -> Array:
        """Spread one value per block, shape (blocks,), to one per taxel, shape (n,); 0 at gaps."""
        with_gap: Array = np.append(of_blocks, of_blocks.dtype.type(0))  # type: ignore[assignment]
        return with_gap[self.block_of_taxel]  # type: ignore[return-value]  # the type stays

    def valid_taxels(self, valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Tell which taxels were measured, shape (n,): those of valid blocks."""
        return self.of_taxels(valid)

    def blocks_of(self, taxels: npt.NDArray[np.bool_]) -> npt.NDArray[np.intp]:
        """Return the blocks of some taxels; `taxels` has shape (n,)."""
        return np.unique(self.block_of_taxel[taxels & self.is_wired])

    def _numbered(self, of_places: npt.NDArray[np.intp], of_gaps: int) -> npt.NDArray[np.intp]:
        found = np.full(self.wired.taxels, of_gaps, np.intp)
        found[self.order] = of_places
        return found[: self.taxels]

    def rows_of(self, block: int) -> list[int]:
        """Hadamard rows that `block` sends, ascending."""
        return [int(row) for row in np.nonzero(self.kept[block])[0]]

    @cached_property
    def fingerprint(self) -> str:
        """16 hex digits that differ whenever any entry of Φ differs."""
        digest = hashlib.sha256()
        digest.update(np.asarray(self.kept.shape, "<u4").tobytes())
        digest.update(self.order.astype("<u4").tobytes())
        digest.update(np.packbits(self.kept).tobytes())
        if self.order.size != self.taxels:
            digest.update(np.uint32(self.taxels).astype("<u4").tobytes())
        return digest.hexdigest()[:16]

    def forward(self, x: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        """Return y = Φ x.

        Parameters
        ----------
        x : array, shape (..., n)
            Taxels, row-major, real and finite. Floats keep their dtype; integers are summed exactly in int32.

        Returns
        -------
        array, shape (..., m)
        """
        check_vectors("taxels", x, self.shape[1])
        sent: npt.NDArray[Any] = x if np.issubdtype(x.dtype, np.floating) else x.astype(np.int32)
        work = self.padded(sent)[..., self._sending_taxels]
        if self._signs is None:
            return fast_hadamard(work)[..., self._sent]
        # B additions for one row in place of B log2 B for all, in the same order: the same bits.
        work = work * self._signs
        while work.shape[-1] > 1:
            work = work[..., ::2] + work[..., 1::2]
        return work[..., 0]

    def padded(self, x: Array) -> Array:
        """Return taxels, shape (..., n), with zeros for the empty places, shape (..., n + empty)."""
        if not self.empty:
            return x
        zeros = np.zeros((*x.shape[:-1], self.empty), x.dtype)
        return np.concatenate((x, zeros), axis=-1)  # type: ignore[return-value]  # the type stays

    def adjoint(self, y: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        """Return Φᵀ y, shape (..., n), of sums `y` of shape (..., m)."""
        check_vectors("sums", y, self.shape[0])
        work = y if np.issubdtype(y.dtype, np.floating) else y.astype(np.int32)
        spread = np.zeros((*y.shape[:-1], *self.kept.shape), work.dtype)
        spread[..., self.kept] = work
        scrambled = fast_hadamard(spread).reshape(*y.shape[:-1], -1)  # W is symmetric
        taxels = np.zeros((*y.shape[:-1], self.wired.taxels), scrambled.dtype)
        taxels[..., self.order] = scrambled
        return taxels[..., : self.shape[1]]


def sbhe(
    taxels: int,
    sums: int,
    *,
    block_size: int = 32,
    blocks: int | None = None,
    gaps: npt.NDArray[np.intp] | None = None,
    selection: Selection = "balanced",
    seed: int = 1,
) -> Sbhe:
    """Draw an SBHE: a seeded permutation of the taxels and a seeded choice of rows.

    Parameters
    ----------
    taxels, sums : int
        n and m.
    blocks : int, optional
        Number of blocks; without it as few as hold the taxels.
    gaps : array of int, optional
        Taxels that the skin lacks, some of the n.
    selection : {"balanced", "uniform"}
        "balanced" selects the same number of rows in every block or, with fewer sums than blocks, one row in each of
        m blocks, one block out of each of m runs of neighbouring blocks. "uniform" draws m of the n rows, as in the
        paper, so blocks send different numbers of sums.
    seed : int
        Same seed, same Φ, on every platform (NumPy's PCG64).
    """
    _check_sizes(taxels if gaps is None else taxels - len(gaps), sums, block_size, blocks)
    there = np.delete(np.arange(taxels), [] if gaps is None else gaps)
    if selection not in get_args(Selection):
        raise InputError(f"expected rows that are {' or '.join(get_args(Selection))}, got '{selection}'")
    blocks = blocks or -(-there.size // block_size)
    random = seeded(seed)
    order = _dealt_evenly(there[random.permutation(there.size)], taxels, blocks, block_size)
    kept = np.zeros((blocks, block_size), np.bool_)
    if selection == "balanced":
        if sums > blocks and sums % blocks:
            raise InputError(f"balanced rows: {sums} sums are not a multiple of {blocks} blocks")
        for block in range(blocks):
            kept[block, random.permutation(block_size)[: max(1, sums // blocks)]] = True
        if sums < blocks:
            kept[~_one_of_each_run(blocks, sums, random)] = False
    else:
        kept.flat[random.permutation(order.size)[:sums]] = True
    return Sbhe(order, kept, taxels)


def _dealt_evenly(there: npt.NDArray[np.intp], taxels: int, blocks: int, block_size: int) -> npt.NDArray[np.intp]:
    """Deal taxels out to blocks, as many to each as to the others; the empty places of a block are its last."""
    each, more = divmod(there.size, blocks)
    held = np.arange(block_size) < (each + (np.arange(blocks) < more))[:, None]
    order = np.empty(held.shape, np.intp)
    order[held] = there
    order[~held] = np.arange(taxels, taxels + order.size - there.size)
    return order.ravel()


def _one_of_each_run(blocks: int, runs: int, random: np.random.Generator) -> npt.NDArray[np.bool_]:
    """Draw one block out of each of `runs` runs of neighbouring blocks, so that each node sends its share."""
    ends = np.arange(runs + 1) * blocks // runs
    drawn = np.zeros(blocks, np.bool_)
    drawn[random.integers(ends[:-1], ends[1:])] = True
    return drawn


def of_rows(phi: Sbhe, rows: Sequence[tuple[int, int]]) -> Sbhe:
    """Return the SBHE with the blocks of another that sends the named rows.

    Parameters
    ----------
    phi : Sbhe
        Its own rows do not matter.
    rows : sequence of (int, int)
        Block and Hadamard row of each sum.
    """
    kept = np.zeros_like(phi.kept)
    for block, row in rows:
        if not (0 <= block < phi.blocks and 0 <= row < phi.block_size):
            limits = f"blocks of 0 to {phi.blocks - 1} and rows of 0 to {phi.block_size - 1}"
            raise InputError(f"expected {limits}, got block {block}, row {row}")
        if kept[block, row]:
            raise InputError(f"row {row} of block {block} is named twice")
        kept[block, row] = True
    return replace(phi, kept=kept)


def places(phi: Sbhe, part: Sbhe) -> npt.NDArray[np.intp]:
    """Return where the sums of `part`, some of those of `phi`, are among those of `phi`; shape (m of `part`,)."""
    return np.flatnonzero(part.kept[phi.kept])


def _check_sizes(taxels: int, sums: int, block_size: int, blocks: int | None) -> None:
    """Raise InputError unless an SBHE of these sizes exists."""
    if not all(isinstance(each, int | np.integer) for each in (taxels, sums, block_size)):
        raise InputError(f"expected whole numbers, got {taxels} taxels, {sums} sums and blocks of {block_size}")
    if block_size < 1 or block_size & (block_size - 1):
        raise InputError(f"expected blocks of a power of two, got blocks of {block_size} taxels")
    if taxels < 1:
        raise InputError(f"expected one taxel or more, got {taxels}")
    least = -(-taxels // block_size)
    if blocks is not None and not least <= blocks <= taxels:
        raise InputError(f"expected {least} to {taxels} blocks of {taxels} taxels, got {blocks}")
    most = (blocks or least) * block_size
    if not 0 < sums <= most:
        raise InputError(f"expected 1 to {most} sums of {taxels} taxels, got {sums}")


def seeded(seed: int) -> np.random.Generator:
    """Return the random generator from which Φ is drawn; it is the same on every platform."""
    if seed < 0:
        raise InputError(f"expected a seed of 0 or above, got {seed}")
    return np.random.Generator(np.random.PCG64(seed))
