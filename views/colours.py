"""The colours of tactile images: a perceptually uniform map, equal steps of force are equal steps in OKLab.

The path runs from near-black blue over teal to pale yellow. Lightness rises evenly, so the map works in grey and for
every colour vision. The path is cut into pieces of equal length. Source of OKLab: B. Ottosson, 2020.
"""

from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

#: Number of colours.
STEPS: Final = 256
_SAMPLES: Final = 2048
#: Chroma falls in such steps until sRGB can show the colour.
_CHROMA_STEP: Final = 0.002
_TOLERANCE: Final = 1e-4

_LMS_OF_OKLAB: Final = np.array(
    [[1.0, 0.3963377774, 0.2158037573], [1.0, -0.1055613458, -0.0638541728], [1.0, -0.0894841775, -1.291485548]]
)
_RGB_OF_LMS: Final = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.707614701],
    ]
)

_Floats = npt.NDArray[np.float64]


@cache
def colours() -> npt.NDArray[np.uint8]:
    """Return the red, green and blue of all colours, shape (256, 3), from no force to the top of the scale."""
    part = np.linspace(0, 1, _SAMPLES)
    lightness, hue = 0.17 + 0.79 * part, np.deg2rad(285 - 180 * part**1.15)
    chroma = 0.045 + 0.072 * np.sin(np.pi * np.minimum(1, 0.12 + 0.85 * part))
    while (beyond := (chroma > 0) & ~_is_shown(_linear(lightness, chroma, hue))).any():
        chroma[beyond] -= _CHROMA_STEP
    path = _oklab(lightness, chroma, hue)
    length = np.concatenate(([0.0], np.linalg.norm(np.diff(path, axis=0), axis=1).cumsum()))
    chosen = np.searchsorted(length, np.linspace(0, length[-1], STEPS)).clip(max=_SAMPLES - 1)
    linear = _linear(lightness, chroma, hue)[chosen].clip(0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    made: npt.NDArray[np.uint8] = np.rint(255 * srgb).astype(np.uint8)
    return made


def coloured(forces_n: npt.NDArray[np.floating], top_n: float) -> npt.NDArray[np.uint8]:
    """Return the colours of forces on a scale from 0 to `top_n`, shape (..., 3)."""
    places = np.floor(forces_n * ((STEPS - 1) / top_n) + 0.5).clip(0, STEPS - 1).astype(np.intp)
    shown: npt.NDArray[np.uint8] = colours()[places]
    return shown


def script() -> str:
    """Return the colours as a JavaScript module for the page: red, green, blue in turn."""
    return f"export const COLOURS = new Uint8Array({colours().ravel().tolist()});\n"


def _oklab(lightness: _Floats, chroma: _Floats, hue: _Floats) -> _Floats:
    return np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=-1)


def _linear(lightness: _Floats, chroma: _Floats, hue: _Floats) -> _Floats:
    """Return linear sRGB of OKLCH, hue in radians."""
    linear: _Floats = (_oklab(lightness, chroma, hue) @ _LMS_OF_OKLAB.T) ** 3 @ _RGB_OF_LMS.T
    return linear


def _is_shown(linear: _Floats) -> npt.NDArray[np.bool_]:
    """Tell which colours sRGB can show."""
    shown: npt.NDArray[np.bool_] = np.all((linear >= -_TOLERANCE) & (linear <= 1 + _TOLERANCE), axis=-1)
    return shown
