"""The project's own banana, cup, drill, clamp and mustard bottle: the side that faces the array.

These shapes are used without meshes. Each shape has the frame and size of the YCB object of the paper, so trajectories
have the same starts for shape and mesh. The knots were fitted to the contact at 12 mm depth. Bumps of the scanned
surfaces are left out.

Lengths are millimetres; a rod's knots are x, y, height of the top, and radius.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from touch.contact import Spheres
from touch.primitives import Knots, rim, rods

#: It lies flat: one bent rod.
_BANANA: Final[tuple[Knots, ...]] = (
    (
        (-66.1, 23.9, -7.8, 23.8),
        (-60.1, 21.4, -6.3, 19.5),
        (-53.4, 2.6, -2.6, 22.0),
        (-33.5, -16.1, -1.4, 22.3),
        (-36.7, -14.1, -0.1, 16.2),
        (-5.6, -32.2, -1.6, 20.9),
        (20.4, -41.4, -4.1, 25.0),
        (39.1, -42.8, -4.2, 22.9),
        (56.3, -46.7, -6.5, 18.4),
    ),
)
#: On its side: a rod for the motor, two parallel rods for the foot of the grip.
_DRILL: Final[tuple[Knots, ...]] = (
    (
        (-56.4, -72.3, -9.3, 20.6),
        (-54.1, -64.0, -7.9, 23.2),
        (-53.1, -42.7, -6.7, 30.3),
        (-53.1, -26.1, -3.4, 32.1),
        (-54.4, -20.1, -2.5, 26.8),
        (-53.4, -13.9, -3.6, 33.8),
        (-52.9, -2.0, -4.6, 38.9),
        (-52.6, 7.0, -3.8, 38.5),
        (-51.7, 13.6, -3.7, 35.5),
        (-53.5, 20.6, -4.3, 25.4),
        (-52.3, 39.0, -5.5, 21.4),
        (-51.7, 52.5, -7.3, 28.1),
        (-50.9, 69.0, -7.0, 22.4),
    ),
    (
        (92.3, -31.6, -8.4, 18.3),
        (91.8, -27.6, -4.0, 17.3),
        (92.0, -10.4, -2.0, 19.4),
        (90.3, 34.9, -3.9, 28.9),
        (91.2, 44.1, -2.5, 16.4),
        (94.3, 58.7, -16.3, 21.1),
    ),
    (
        (94.2, -36.6, -6.8, 3.7),
        (94.5, -22.4, -1.6, 12.3),
        (95.0, 13.9, 0.1, 14.2),
        (95.2, 33.3, -0.3, 13.8),
        (93.2, 39.9, -0.8, 15.3),
        (100.7, 65.5, -17.0, 3.4),
    ),
)
#: A spring clamp on its side: a long bent rod with the pivot, and a short rod.
_CLAMP: Final[tuple[Knots, ...]] = (
    (
        (96.0, -79.9, -7.1, 6.8),
        (87.2, -74.4, -5.1, 10.9),
        (76.3, -65.7, -3.8, 12.8),
        (50.0, -43.4, -4.1, 17.7),
        (22.3, -20.7, -4.0, 22.3),
        (6.1, -20.8, -4.2, 20.5),
        (-29.3, -30.6, -4.3, 26.4),
        (-74.4, -11.0, -5.6, 12.0),
        (-65.3, -0.6, -5.8, 45.2),
        (-83.8, 0.8, -2.0, 14.3),
        (-71.2, 13.4, -3.2, 10.9),
        (-44.1, 25.9, -5.2, 20.7),
        (-33.0, 31.1, -4.9, 19.7),
        (-17.9, 29.5, -4.9, 19.4),
        (15.3, 11.4, -5.2, 35.0),
        (1.6, 2.9, 0.1, 13.9),
        (10.2, -3.7, -0.2, 31.7),
        (-5.2, -19.1, -3.8, 13.2),
    ),
    (
        (1.8, 15.1, -2.8, 23.3),
        (24.0, 23.5, -8.0, 30.2),
        (50.1, 44.0, -10.5, 12.5),
    ),
)
#: A bottle on its broad side: three rods side by side.
_MUSTARD_LYING: Final[tuple[Knots, ...]] = (
    (
        (-35.2, -2.9, -0.8, 22.0),
        (-20.6, -12.1, -2.9, 34.3),
        (22.6, -13.1, -2.0, 27.3),
        (54.6, -7.1, -2.5, 48.4),
        (78.3, -18.5, -2.5, 25.8),
    ),
    (
        (-49.8, -0.7, -4.9, 21.4),
        (-4.1, -4.1, -1.6, 67.3),
        (62.8, 3.2, -1.7, 62.5),
        (63.3, 9.6, -1.9, 52.8),
        (81.0, -7.7, 0.2, 17.1),
    ),
    (
        (-36.7, 1.8, -0.7, 22.5),
        (-11.4, 13.2, -3.7, 51.1),
        (39.9, 12.0, -2.6, 33.3),
        (79.9, 24.3, -3.3, 20.1),
        (81.6, 5.4, 0.3, 15.8),
    ),
)
#: The nozzle of an upright bottle: three balls.
_MUSTARD_UPRIGHT: Final[tuple[Knots, ...]] = (
    ((0.4, 1.6, -0.2, 10.2),),
    ((1.6, 0.5, -1.9, 12.7),),
    ((2.0, 2.0, -9.0, 13.0),),
)
#: Middle x, y of the cup, and the slope of its rim along x and y: the cup is tilted like its mesh.
_CUP_MIDDLE: Final = (-0.35, -0.33)
_CUP_SLOPE: Final = (-0.003, 0.0114)
#: The lip of a standing cup, from inside to outside: radius of a circle, height of its top, radius of its spheres.
_CUP: Final[Knots] = (
    (46.15, 0.11, 0.51),
    (44.2, -1.2, 3.31),
    (41.98, -3.46, 2.66),
    (40.41, -5.8, 1.99),
    (38.73, -8.87, 1.36),
    (48.01, -1.33, 3.23),
    (50.08, -4.96, 2.43),
    (50.66, -7.43, 2.2),
)


def _rods(parts: Sequence[Knots]) -> Spheres:
    return rods([np.array(knots) / 1e3 for knots in parts])


def _cup() -> Spheres:
    x, y = _CUP_MIDDLE
    return rim(np.array(_CUP) / 1e3, (x / 1e3, y / 1e3), _CUP_SLOPE)


#: Builders by the name of the object.
SHAPES: Final[dict[str, Callable[[], Spheres]]] = {
    "banana": partial(_rods, _BANANA),
    "cup": _cup,
    "drill": partial(_rods, _DRILL),
    "clamp": partial(_rods, _CLAMP),
    "mustard-lying": partial(_rods, _MUSTARD_LYING),
    "mustard-upright": partial(_rods, _MUSTARD_UPRIGHT),
}
