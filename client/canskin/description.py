"""What a program has to know of a skin to use its messages."""

from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.question import Question
from canskin.text import Told


class DescriptionRequest(msgspec.Struct, frozen=True):
    """Asks for the description."""


class Description(Told, frozen=True, kw_only=True):
    """The geometry of a skin, and how it sends.

    Attributes
    ----------
    name : str
    rows, columns : int
    pitch_m : float
        Distance of neighbouring taxels.
    blocks, sums : int
        Number of blocks, and of sums of all blocks.
    order : bytes
        uint32, shape (blocks, block size): row-major numbers of the taxels of each block, in the order of its chain.
    kept : bytes
        uint8, shape (blocks, block size): 1 for each Hadamard row that the block sends. `order` and `kept` are Φ, see
        docs/firmware.md.
    newton_per_count : float
        Force of one count of a taxel.
    force_max_n : float
        Largest force of one taxel.
    rate_hz : float
        Cycles in a second; stepped: samples in a second.
    sending : str
        ``synchronous`` or ``steps``.
    fingerprint : str
        Fingerprint of Φ.
    boot_id : str
        `canskin.skin_clock.machine` of the gateway. Empty if unknown.
    is_grid : bool
        Whether the taxels are a grid. Else there is one row, and `positions` and `normals` tell the shape.
    positions, normals : bytes
        float32, shape (n, 3): where each taxel lies, metres, and its normal out of the skin; see `docs/layout.md` for
        the frame. Empty from a gateway that does not tell.
    masked : bytes
        uint32: row-major numbers of broken taxels, which are left out of images.
    """

    name: str
    rows: int
    columns: int
    pitch_m: float
    blocks: int
    sums: int
    order: bytes
    kept: bytes
    newton_per_count: float
    force_max_n: float
    rate_hz: float
    sending: str
    fingerprint: str
    boot_id: str = ""
    is_grid: bool = True
    positions: bytes = b""
    normals: bytes = b""
    masked: bytes = b""

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of an array with a value of each taxel: (rows, columns) of a grid, else (n,)."""
        return (self.rows, self.columns) if self.is_grid else (self.rows * self.columns,)

    @property
    def positions_m(self) -> npt.NDArray[np.float32]:
        """Where each taxel lies, shape (n, 3); (0, 3) if the gateway does not tell."""
        return np.frombuffer(self.positions, "<f4").reshape(-1, 3)

    @property
    def unit_normals(self) -> npt.NDArray[np.float32]:
        """The normal of each taxel, of length 1, out of the skin, shape as `positions_m`."""
        return np.frombuffer(self.normals, "<f4").reshape(-1, 3)

    @property
    def in_cycles(self) -> bool:
        """Whether all sums of an instant come together, `rate_hz` times a second."""
        return self.sending == "synchronous"

    @property
    def block_of_taxel(self) -> npt.NDArray[np.intp]:
        """The block of each taxel, of `shape`; the taxels of a block are valid together.

        Where the grid has a gap: the number of blocks.
        """
        order = np.frombuffer(self.order, "<u4")
        # Places of boards without a taxel are numbered after the taxels.
        blocks = np.full(max(int(order.max()) + 1, self.rows * self.columns), self.blocks, np.intp)
        blocks[order] = np.arange(order.size) // (order.size // self.blocks)
        return blocks[: self.rows * self.columns].reshape(self.shape)

    @property
    def block_of_sum(self) -> npt.NDArray[np.intp]:
        """The block of each sum, shape (m,)."""
        return np.nonzero(np.frombuffer(self.kept, np.uint8).reshape(self.blocks, -1))[0]

    @property
    def row_of_sum(self) -> npt.NDArray[np.intp]:
        """The Hadamard row of each sum in its block, shape (m,)."""
        return np.nonzero(np.frombuffer(self.kept, np.uint8).reshape(self.blocks, -1))[1]


class LayoutRequest(msgspec.Struct, frozen=True):
    """Asks for the layout."""


class LayoutReply(msgspec.Struct, frozen=True):
    """The layout of a skin as TOML, with the content of all files that it names."""

    toml: str


#: The gateway answers both.
LAYOUT: Final = Question("layout", LayoutRequest, LayoutReply)
DESCRIPTION: Final = Question("description", DescriptionRequest, Description)
