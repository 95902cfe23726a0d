"""Tactile images as pictures: colours and marks of the page, a line of text below.

Skins that are no grid are drawn as `skin.plane.Plane` has them.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from canskin.messages import Contact
from skin.layout import Layout
from skin.plane import Plane
from skin.taxel_places import contact_place_m
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
#: Where there is no taxel: the ground of images on the page when it is dark.
_NOTHING: Final = np.array([[0x23, 0x2A, 0x31]], np.uint8)
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
        Of the arrays of a skin: rows and columns.
    cell : int
        Pixels between neighbours: of a taxel of a grid in each direction.
    height, width : int
        Of a picture.
    """

    def __init__(self, layout: Layout, top_n: float) -> None:
        self.shape = layout.taxels.rows, layout.taxels.columns
        self._top_n, self._phi, self._surface = top_n, layout.phi(), layout.taxels.surface
        self._plane, self._is_masked = Plane(self._surface), layout.taxels.is_masked
        self.cell = max(LEAST_CELL, 2 * (SIDE // round(max(self._plane.width, self._plane.height)) // 2))
        taxels = self._plane.cells(self.cell)
        height, width = taxels.shape
        #: The taxel of each pixel; -1: none.
        self._taxels = taxels[: height // 2 * 2, : width // 2 * 2]
        self.height, self.width = self._taxels.shape[0] + LINE, self._taxels.shape[1]

    def draw(
        self, forces_n: npt.NDArray[np.floating], valid: npt.NDArray[np.bool_], contacts: Sequence[Contact], text: str
    ) -> Picture:
        """Return the picture of an image, shape (height, width, 3): red, green and blue.

        Parameters
        ----------
        forces_n : array, shape (rows, columns)
        valid : array of bool, shape (blocks,)
            Taxels of other blocks are hatched, and masked ones.
        contacts : sequence of Contact
            A cross at the centre of force, with the identity.
        text : str
            Below the image.
        """
        from PIL import Image

        picture = np.zeros((self.height, self.width, 3), np.uint8)
        image = picture[:-LINE]
        colours = np.append(coloured(forces_n.ravel(), self._top_n), _NOTHING, axis=0)
        image[:] = np.take(colours, self._taxels, axis=0)
        hatched = np.take(np.append(~self._phi.of_taxels(valid) | self._is_masked, False), self._taxels)
        if hatched.any():
            image[hatched] = self._hatching[hatched]
        return self._written(Image.fromarray(picture), contacts, text)

    def old(self, picture: Picture, text: str) -> Picture:
        """Return a picture without colours, under which `text` says why it is old."""
        from PIL import Image

        grey = (_OLD * picture.mean(axis=2)).astype(np.uint8)
        grey[-LINE:] = 0
        return self._written(Image.fromarray(grey).convert("RGB"), (), text)

    @cached_property
    def _hatching(self) -> Picture:
        """Diagonal lines that continue from one taxel to the next."""
        height, width = self._taxels.shape
        is_line = np.add.outer(np.arange(height), np.arange(width))[..., None] % self.cell < max(1, self.cell // 3)
        return np.where(is_line, _HATCH_LINE, _HATCH_GROUND).astype(np.uint8)

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
        place = self._plane.place(contact_place_m(self._surface, contact), contact.normal)
        x, y = np.rint(place * self.cell).astype(int).tolist()
        for colour, width in (("black", 3), ("white", 1)):
            pen.line((x - self.cell, y, x + self.cell, y), colour, width)
            pen.line((x, y - self.cell, x, y + self.cell), colour, width)
        return x, y
