"""Skins that are no grid, for tests."""

from typing import Any

import numpy as np
import tomli_w

from skin.layout import Layout, parse_layout
from skin.surface import Surface, grid_surface, surface_of_positions

PITCH_M = 0.004
RADIUS_M = 0.03


def grid(rows: int, columns: int) -> Surface:
    """Return a grid without gaps."""
    return grid_surface(rows, columns, PITCH_M, np.zeros(0, np.intp))


def places(rows: int, columns: int) -> np.ndarray:
    """Return the positions of a grid, shape (n, 3)."""
    return grid(rows, columns).positions_m


def tube(rings: int = 10, around: int = 24, radius_m: float = RADIUS_M) -> np.ndarray:
    """Return positions on a tube around z, ring after ring from angle 0, every second one turned by half a step."""
    ring, step = np.divmod(np.arange(rings * around), around)
    angle = 2 * np.pi * (step + 0.5 * (ring % 2)) / around
    return np.stack((radius_m * np.cos(angle), radius_m * np.sin(angle), 0.0068 * ring), axis=1)


def two_patches() -> Surface:
    """Return 8 x 8 taxels at positions without column 4: islands of four and of three columns."""
    return surface_of_positions(np.delete(places(8, 8), np.arange(4, 64, 8), axis=0).tolist())


def tube_layout(rings: int = 20, radius_m: float = RADIUS_M, **tables: Any) -> Layout:
    """Return the layout of a tube of 24 taxels a ring; `tables` as in a file."""
    taxels = {"positions": tube(rings, radius_m=radius_m).tolist()}
    content = {"measurement": {"sums": 12 * rings}, "taxels": taxels} | tables
    return parse_layout(tomli_w.dumps(content).encode(), "tube.toml")
