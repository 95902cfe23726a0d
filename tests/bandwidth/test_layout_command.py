"""``skin layout``: what is made, refused and drawn, on any skin."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from bandwidth.layout_command import layout
from canskin.errors import LayoutError
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


@pytest.mark.heavy
@pytest.mark.parametrize(("grid", "sums"), [("8x8", 64), ("16x16", 128), ("24x32", 192)])
def test_a_new_skin_has_as_many_sums_as_its_buses_carry_easily(tmp_path: Path, grid: str, sums: int) -> None:
    out = tmp_path / "new.toml"
    assert layout("new", Path(grid), out=out) == 0
    made = load_layout(out)
    assert (made.measurement.sums, len(made.bus)) == (sums, 1)


def test_a_message_of_another_device_with_the_identifier_of_a_sum_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    foreign = "[[bus.foreign]]\nname = 'drive'\nidentifier = 0x181\nlength = 8\nperiod_s = 0.01\n"
    path.write_text(f"taxels = {{rows = 8, columns = 8}}\n[[bus]]\nname = 'arm'\nnodes = 2\n{foreign}")
    with pytest.raises(LayoutError, match="181h"):
        layout("check", path)
