from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError
from touch.drawing import as_text, save_images


def test_text_is_cut_to_the_contact_and_darker_with_force() -> None:
    force_n = np.zeros((7, 9), np.float32)
    force_n[2, 3:6] = (0.0001, 0.005, 0.00999)
    force_n[6, 4] = 0.02
    assert as_text(force_n) == ".+@\n\n @"
    assert as_text(np.zeros((4, 4), np.float32)) == "no contact"


@pytest.mark.heavy
@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_a_picture_of_any_number_of_objects(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"objects.{ending}"
    save_images({str(index): np.zeros((8, 8), np.float32) for index in range(7)}, path)
    assert path.stat().st_size > 2000


def test_places_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        save_images({"ball": np.zeros((8, 8), np.float32)}, tmp_path / "folder.png")
