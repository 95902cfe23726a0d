"""What several tests of the reconstructor share: refused input, and measurements of the default skin."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from canskin.errors import InputError
from canskin.messages import Measurement
from skin.layout import Layout, load_layout
from tests import messages as make

NAN, INF = float("nan"), float("inf")


def spoilt(values: np.ndarray, value: float) -> np.ndarray:
    made = np.array(values)
    made.flat[3] = value
    return made


def one_line(call: Callable[[], Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        call()
    assert "\n" not in str(caught.value)


LAYOUT: Layout = load_layout()


def measurement(cycle: int, force_n: np.ndarray, valid: np.ndarray | None = None) -> Measurement:
    phi = LAYOUT.phi()
    counts = np.round(force_n / LAYOUT.taxels.newton_per_count).astype(np.uint16)
    valid = np.ones(phi.blocks, np.uint8) if valid is None else valid.astype(np.uint8)
    sums = np.asarray(phi.forward(counts.reshape(-1)), "<i4") * phi.sums_of_blocks(valid != 0)
    return make.measurement(
        cycle,
        sampled_mono_ns=1000 * cycle,
        sums=sums.astype("<i4").tobytes(),
        valid=valid.tobytes(),
        fingerprint=phi.fingerprint,
    )
