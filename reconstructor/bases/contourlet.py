"""The contourlet: a Laplacian pyramid, and a directional filter bank on its detail (Do and Vetterli 2005)."""

from canskin.errors import InputError
from reconstructor.bases.directional import bank
from reconstructor.bases.pkva import pyramid_pair
from reconstructor.checks import is_whole

#: 2⁵ directions: the toolbox's nlevs = [5].
LEVELS = 5


class Contourlet:
    """Ψ of shape (n, 5n/4): x = Ψs; with D the coarse image's filters down, U up, and F the directional bank.

        analysis    c = D x Dᵀ,  s = (c, F(x - U c Uᵀ))
        synthesis   d = F⁻¹s_d,  x = d + U (c - D d Dᵀ) Uᵀ

    Coefficients are in the order of the toolbox's ``pdfbdec`` with nlevs = [5]: the low-pass image, then 16 bands of
    (rows / 16, columns / 2), then 16 of (rows / 2, columns / 16), each row by row. Ψ is neither tight nor orthogonal:
    FISTA needs its transpose; the analysis is a left inverse. This class has the geometry alone: the methods of a basis
    are those of `reconstructor.kernels.contourlet.CompiledContourlet`.

    Parameters
    ----------
    rows, columns : int
        Equal, a power of two, 16 to 256: the shears of the bank need a square.
    """

    def __init__(self, rows: int, columns: int) -> None:
        if rows != columns or not is_whole(rows) or rows & (rows - 1) or not 16 <= rows <= 256:
            raise InputError(f"a contourlet needs a square, a power of two, 16 to 256: got {rows} x {columns}")
        self.image_shape = (rows, columns)
        self.shape = (5 * rows * columns // 4,)
        self.levels, self.order = bank(rows, LEVELS)
        self.pair = pyramid_pair(rows)
