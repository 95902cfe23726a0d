"""Contents of messages in the tests of scores."""

import numpy as np


def pixels(force_n: float, error_n: float = 0.0) -> bytes:
    """Return the forces of 64 x 64 taxels, of which the first eight rows are touched."""
    grid = np.zeros((64, 64), "<f4")
    grid[:8] = force_n
    return (grid + np.float32(error_n)).astype("<f4").tobytes()
