"""The picture of a run: where it can be saved, and that it is one."""

from pathlib import Path

import numpy as np
import pytest

from demo.picture import save_picture
from demo.score import CycleImages
from shell.output import PICTURE_SUFFIXES, check_output_path
from tests.layouts import small_layout, tube_layout


@pytest.mark.heavy
@pytest.mark.parametrize("suffix", PICTURE_SUFFIXES)
def test_picture_is_saved_where_it_may_be(suffix: str, tmp_path: Path) -> None:
    layout = tube_layout() if suffix == ".png" else small_layout(16, 16)
    force_n = np.random.default_rng(0).uniform(0, 0.02, layout.taxels.surface.shape).astype(np.float32)
    path = tmp_path / f"picture{suffix}"
    check_output_path(path, "picture", *PICTURE_SUFFIXES)
    save_picture(CycleImages(force_n, force_n, 0.9 * force_n), layout.taxels, path)
    starts = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}
    assert path.read_bytes().startswith(starts[suffix])
