"""``skin layout draw``: boards in their colours, on any skin."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from demo.layout_command import layout
from skin.layout import load_layout
from tests import surfaces

HEADER = "x_m,y_m,z_m"
#: Half a tube of 8 x 12 taxels, and a flat patch.
HALF_TUBE = surfaces.tube(8, 24)[np.tile(np.arange(24) < 12, 8)]
FLAT = surfaces.places(8, 12)


def drawn(folder: Path, places_m: np.ndarray) -> tuple[Path, np.ndarray]:
    """Return a layout whose positions are in a CSV file, and the picture of its boards."""
    np.savetxt(folder / "skin.csv", places_m, "%.6f", ",", header=HEADER, comments="")
    path = folder / "skin.toml"
    path.write_text('[taxels]\npositions = "skin.csv"\n[measurement]\nwiring = "board"\n')
    assert layout("draw", path, out=folder / "skin.png", json_=True) == 0
    return path, np.asarray(Image.open(folder / "skin.png").convert("RGB")).astype(int)


@pytest.mark.heavy
def test_each_board_of_a_skin_that_is_no_grid_has_a_colour(tmp_path: Path) -> None:
    path, picture = drawn(tmp_path, FLAT)
    found, pixels = np.unique(picture.reshape(-1, 3), axis=0, return_counts=True)
    assert (pixels[np.ptp(found, axis=1) > 50] > 1000).sum() == load_layout(path).blocks == 3


@pytest.mark.heavy
def test_a_curved_skin_is_drawn_in_space_too(tmp_path: Path) -> None:
    _, flat = drawn(tmp_path, FLAT)
    _, curved = drawn(tmp_path, HALF_TUBE)
    assert curved.shape[0] / curved.shape[1] > flat.shape[0] / flat.shape[1] + 0.5
