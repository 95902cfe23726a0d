"""Plots of the rivals: error against bits, latency, and traffic that noise alone makes."""

from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evaluation.findings import Options, Picture, Row
from evaluation.schemes.contenders import DEFAULT_KBIT_PER_S
from evaluation.schemes.scenes import SLIDES

#: Panels of the curves: their touches' mean.
PANELS: Final = {
    "five slides": SLIDES,
    "golf ball at rest": ("golf ball at rest",),
    "three boxes slapped on": ("three boxes slapped on",),
    "two boxes shaking": ("two boxes shaking",),
}
