"""Tactile images as pictures: colours and marks of the page, a line of text below."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from canskin.messages import Contact
from skin.layout import Layout
from views.colours import coloured

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

#: Wanted size of the longer side of an image, and the least size of a taxel, pixels.
SIDE: Final = 512
LEAST_CELL: Final = 4
#: Height of the line of text. Heights and widths are even, as video has half as many pixels of colour.
LINE: Final = 24
_TEXT: Final = 14
_HATCH_GROUND: Final = (0x8A, 0x90, 0x97)
_HATCH_LINE: Final = (0x4D, 0x53, 0x5A)
#: Part of the brightness that a picture keeps, without its colours, when it is no longer current.
_OLD: Final = 0.4

Picture = npt.NDArray[np.uint8]


class Drawing:
    """Draws the images of a skin.

    Parameters
    ----------
    top_n : float
        Top of the colour scale, newtons.

    Attributes
    ----------
    shape : tuple of int
        Rows and columns of an image.
    cell : int
        Pixels of a taxel in each direction.
    height, width : int
        Of a picture.
    """

    def __init__(self, layout: Layout, top_n: float) -> None:
        self.shape = rows, columns = layout.taxels.rows, layout.taxels.columns
        self._top_n = top_n
        self.cell = max(LEAST_CELL, 2 * (SIDE // max(self.shape) // 2))
        self.height, self.width = rows * self.cell + LINE, columns * self.cell
        self._phi = layout.phi()
        self._hatching = np.tile(_hatched(self.cell), (rows, columns, 1))

    def draw(
        self, forces_n: npt.NDArray[np.floating], valid: npt.NDArray[np.bool_], contacts: Sequence[Contact], text: str
    ) -> Picture:
        """Return the picture of an image, shape (height, width, 3): red, green and blue.

        Parameters
        ----------
        forces_n : array, shape (rows, columns)
        valid : array of bool, shape (blocks,)
            Taxels of other blocks are hatched.
        contacts : sequence of Contact
            A cross at the centre of force, with the identity.
        text : str
            Below the image.
        """
        from PIL import Image

        picture = Image.new("RGB", (self.width, self.height))
        picture.paste(self._large(coloured(forces_n, self._top_n)))
        if not (valid.all() and self._phi.is_wired.all()):
            hatched = np.where(self._phi.of_taxels(valid).reshape(self.shape), 0, 255).astype(np.uint8)
            picture.paste(Image.fromarray(self._hatching), mask=self._large(hatched))
        return self._written(picture, contacts, text)

    def old(self, picture: Picture, text: str) -> Picture:
        """Return a picture without colours, under which `text` says why it is old."""
        from PIL import Image

        grey = (_OLD * picture.mean(axis=2)).astype(np.uint8)
        grey[-LINE:] = 0
        return self._written(Image.fromarray(grey).convert("RGB"), (), text)

    def _large(self, small: Picture) -> "Image":
        from PIL import Image

        size = self.width, self.height - LINE
        return Image.fromarray(small).resize(size, Image.Resampling.NEAREST)

    def _written(self, picture: "Image", contacts: Sequence[Contact], text: str) -> Picture:
        from PIL import ImageDraw, ImageFont

        pen, font = ImageDraw.Draw(picture), ImageFont.load_default(_TEXT)
        for each in contacts:
            x, y = self._mark(pen, each)
            spot = x + self.cell, y - self.cell // 2
            words = f"{each.identity}{'?' * each.doubtful}"
            pen.text(spot, words, "white", font, anchor="ls", stroke_width=2, stroke_fill="black")
        pen.text((LINE // 4, self.height - LINE // 2), text, "white", font, anchor="lm")
        return np.asarray(picture)

    def _mark(self, pen: "ImageDraw", contact: Contact) -> tuple[int, int]:
        """Draw a cross at the centre of force; return its place."""
        x, y = round((contact.column + 0.5) * self.cell), round((contact.row + 0.5) * self.cell)
        for colour, width in (("black", 3), ("white", 1)):
            pen.line((x - self.cell, y, x + self.cell, y), colour, width)
            pen.line((x, y - self.cell, x, y + self.cell), colour, width)
        return x, y


def _hatched(cell: int) -> Picture:
    """Return a taxel with diagonal lines that continue from one taxel to the next."""
    across = np.arange(cell)
    is_line = (across[:, None] + across) % cell < max(1, cell // 3)
    return np.where(is_line[..., None], _HATCH_LINE, _HATCH_GROUND).astype(np.uint8)
