"""The numbers the paper prints: its Tables I to III and the PSNR in the caption of its sample images.

Objects and bases have the names of `touch.trajectory` and of this package. PSNR in dB, times in milliseconds.
"""

from typing import Final, Literal, NamedTuple

Matrix = Literal["sbhe", "noiselet"]
BasisName = Literal["haar", "contourlet"]

#: Abstract: images of 4096 taxels "at a rate over" this many a second.
RATE_HZ: Final = 100.0


class Psnr(NamedTuple):
    """Mean, least and largest PSNR over the 4200 steps of a trajectory, dB."""

    mean: float
    least: float
    most: float


class Speed(NamedTuple):
    """A cell of Table III: mean time of one reconstruction on the authors' GPU, and the PSNR."""

    ms: float
    psnr: Psnr


def _pair(*numbers: float) -> dict[BasisName, Psnr]:
    haar, contourlet = Psnr(*numbers[:3]), Psnr(*numbers[3:])
    return {"haar": haar, "contourlet": contourlet}


#: Table I: mean and largest number of coefficients above 0.001 N.
TABLE_ONE: Final[dict[str, dict[str, tuple[float, int]]]] = {
    "haar": {
        "golf-ball": (95.9, 146),
        "granola-box": (95.3, 209),
        "drill": (176.4, 265),
        "cup": (353.2, 462),
        "clamp": (310.0, 425),
    },
    "d4": {
        "golf-ball": (93.1, 152),
        "granola-box": (206.5, 357),
        "drill": (178.1, 250),
        "cup": (351.3, 451),
        "clamp": (238.5, 329),
    },
    "dct": {
        "golf-ball": (148.4, 203),
        "granola-box": (360.2, 602),
        "drill": (176.1, 235),
        "cup": (404.0, 522),
        "clamp": (222.9, 291),
    },
    "contourlet": {
        "golf-ball": (17.4, 23),
        "granola-box": (426.4, 658),
        "drill": (111.6, 144),
        "cup": (164.4, 221),
        "clamp": (139.9, 185),
    },
}

#: Tables II and III: PSNR of the sensor signal.
SENSOR: Final = {
    "golf-ball": Psnr(29.0, 28.5, 29.6),
    "granola-box": Psnr(28.2, 27.7, 29.4),
    "drill": Psnr(28.7, 28.1, 29.5),
    "cup": Psnr(28.8, 28.2, 29.5),
    "clamp": Psnr(28.6, 28.0, 29.5),
}

#: Table II, 20 iterations.
TABLE_TWO: Final[dict[tuple[str, Matrix, int], dict[BasisName, Psnr]]] = {
    ("golf-ball", "sbhe", 1365): _pair(31.4, 29.4, 34.0, 36.6, 35.1, 38.9),
    ("golf-ball", "noiselet", 1365): _pair(31.2, 30.0, 33.3, 35.9, 34.8, 37.5),
    ("golf-ball", "sbhe", 1024): _pair(31.1, 29.5, 34.4, 36.6, 35.1, 39.1),
    ("golf-ball", "noiselet", 1024): _pair(31.1, 29.3, 33.9, 36.4, 35.0, 38.8),
    ("golf-ball", "sbhe", 819): _pair(31.1, 29.3, 35.4, 36.8, 34.8, 41.6),
    ("golf-ball", "noiselet", 819): _pair(30.9, 28.8, 34.2, 36.5, 34.7, 39.5),
    ("granola-box", "sbhe", 1365): _pair(30.2, 28.0, 34.1, 26.1, 23.9, 39.0),
    ("granola-box", "noiselet", 1365): _pair(30.0, 27.9, 33.2, 26.7, 24.5, 37.5),
    ("granola-box", "sbhe", 1024): _pair(29.5, 26.7, 34.4, 21.4, 17.5, 39.1),
    ("granola-box", "noiselet", 1024): _pair(29.4, 26.4, 34.0, 20.6, 16.9, 38.7),
    ("granola-box", "sbhe", 819): _pair(28.7, 25.5, 35.0, 17.8, 14.5, 41.2),
    ("granola-box", "noiselet", 819): _pair(28.7, 25.5, 34.6, 18.2, 14.9, 39.6),
    ("drill", "sbhe", 1365): _pair(30.0, 28.1, 33.9, 32.9, 31.1, 38.7),
    ("drill", "noiselet", 1365): _pair(29.8, 28.0, 33.5, 33.1, 31.5, 37.5),
    ("drill", "sbhe", 1024): _pair(29.3, 27.1, 34.3, 31.9, 29.7, 39.3),
    ("drill", "noiselet", 1024): _pair(29.4, 27.4, 34.0, 32.1, 29.5, 38.7),
    ("drill", "sbhe", 819): _pair(28.8, 26.4, 35.5, 30.3, 27.1, 41.3),
    ("drill", "noiselet", 819): _pair(28.9, 26.8, 34.3, 30.9, 28.2, 39.7),
    ("cup", "sbhe", 1365): _pair(28.0, 26.0, 34.2, 32.6, 30.7, 38.7),
    ("cup", "noiselet", 1365): _pair(28.1, 26.3, 33.5, 32.6, 31.1, 37.6),
    ("cup", "sbhe", 1024): _pair(27.1, 24.9, 34.1, 31.7, 29.8, 39.2),
    ("cup", "noiselet", 1024): _pair(27.2, 25.0, 33.9, 31.6, 29.3, 38.8),
    ("cup", "sbhe", 819): _pair(26.4, 24.0, 35.2, 30.3, 27.9, 41.6),
    ("cup", "noiselet", 819): _pair(26.3, 23.8, 34.4, 30.8, 28.3, 39.6),
    ("clamp", "sbhe", 1365): _pair(28.7, 26.9, 34.0, 31.9, 29.9, 38.7),
    ("clamp", "noiselet", 1365): _pair(28.6, 27.0, 33.6, 32.1, 30.4, 37.4),
    ("clamp", "sbhe", 1024): _pair(27.9, 25.8, 34.5, 30.4, 27.7, 39.3),
    ("clamp", "noiselet", 1024): _pair(27.8, 25.9, 33.8, 30.3, 27.8, 38.8),
    ("clamp", "sbhe", 819): _pair(27.4, 25.1, 35.1, 28.4, 25.3, 41.2),
    ("clamp", "noiselet", 819): _pair(27.3, 24.8, 34.4, 29.0, 25.8, 39.8),
}

#: Table III, 1024 sums: ms, mean, least and largest PSNR with 20, 10 and 5 iterations, by object and basis.
_SPEEDS: Final[dict[tuple[str, BasisName], tuple[tuple[float, ...], ...]]] = {
    ("golf-ball", "haar"): ((6.4, 31.1, 29.3, 33.9), (3.3, 31.4, 29.9, 34.7), (1.8, 31.9, 30.6, 37.5)),
    ("golf-ball", "contourlet"): ((7.7, 36.4, 35.0, 38.8), (4.0, 37.9, 36.6, 41.0), (2.1, 39.5, 38.2, 46.3)),
    ("granola-box", "haar"): ((6.4, 29.4, 26.4, 34.0), (3.3, 30.0, 27.2, 34.3), (1.8, 30.6, 27.4, 37.3)),
    ("granola-box", "contourlet"): ((7.7, 20.6, 16.9, 38.7), (4.0, 20.9, 17.4, 40.6), (2.1, 21.1, 17.1, 45.4)),
    ("drill", "haar"): ((6.4, 29.4, 27.4, 34.0), (3.3, 29.8, 28.0, 34.7), (1.8, 30.3, 28.5, 37.6)),
    ("drill", "contourlet"): ((7.7, 32.1, 29.5, 38.7), (4.0, 33.2, 30.6, 40.6), (2.1, 34.2, 31.4, 45.6)),
    ("cup", "haar"): ((6.4, 27.2, 25.0, 33.9), (3.3, 27.6, 25.5, 35.3), (1.8, 27.9, 25.9, 38.2)),
    ("cup", "contourlet"): ((7.6, 31.6, 29.3, 38.8), (4.1, 32.4, 30.1, 40.5), (2.1, 33.0, 30.6, 45.5)),
    ("clamp", "haar"): ((6.3, 27.8, 25.9, 33.8), (3.3, 28.2, 26.4, 34.7), (1.8, 28.7, 26.9, 37.5)),
    ("clamp", "contourlet"): ((7.6, 30.3, 27.8, 38.8), (4.0, 31.3, 28.8, 40.7), (2.2, 32.2, 29.6, 45.4)),
}
#: The same by object, basis and number of iterations.
TABLE_THREE: Final = {
    (name, basis, iterations): Speed(ms, Psnr(*psnr))
    for (name, basis), cells in _SPEEDS.items()
    for iterations, (ms, *psnr) in zip((20, 10, 5), cells, strict=True)
}

#: Caption of the sample images of the drill: PSNR of the reconstructed and of the sensor signal.
SAMPLE_RECONSTRUCTED_DB: Final = 30.5
SAMPLE_SENSOR_DB: Final = 28.7
