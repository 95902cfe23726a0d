"""The default skin's Φ, and a golf ball pressed into the skin and slid over it."""

import numpy as np
import pytest

from skin.phi import Sbhe
from tests.reconstructor.helpers import LAYOUT, Scene, ball, sense


@pytest.fixture(scope="session")
def phi() -> Sbhe:
    return LAYOUT.phi()


@pytest.fixture(scope="session")
def golf(phi: Sbhe) -> Scene:
    """20 frames of pressing and 40 of sliding at 0.45 mm a frame: 45 mm/s at 100 Hz."""
    press = [ball(0.06, 0.06, 0.01 * k / 20) for k in range(20)]
    slide = [ball(0.06 - 0.0002 * k, 0.06 - 0.0004 * k, 0.01) for k in range(40)]
    return sense(phi, np.stack(press + slide))
