"""Measurements of a skin with adaptive sending, from forces."""

from pathlib import Path
from typing import Any

import numpy as np

from canskin.messages import AdaptiveMeasurement, BlockState
from skin.layout import Layout, load_layout

LAYOUT: Layout = load_layout(Path("adaptive"))
PHI = LAYOUT.phi()


def adaptive_measurement(
    force_n: np.ndarray, known: np.ndarray | None = None, layout: Layout = LAYOUT, **changed: Any
) -> AdaptiveMeasurement:
    """Return what the gateway would publish of these forces; `known`: bool, (blocks, block size)."""
    phi = layout.phi()
    counts = np.rint(force_n.reshape(-1) / layout.taxels.newton_per_count).astype(np.int32)
    known = np.ones(phi.kept.shape, np.bool_) if known is None else known
    sums = np.asarray(phi.forward(counts)).reshape(known.shape) * known
    valid = known.all(axis=1)
    states = np.where(valid, BlockState.FRESH, np.where(known.any(axis=1), BlockState.STALE, BlockState.DEAD))
    about: dict[str, Any] = {
        "cycle": 1,
        "sync_counter": 1,
        "sampled_mono_ns": 1_000_000,
        "fingerprint": phi.fingerprint,
        "noise_n": 1e-3,
    }
    return AdaptiveMeasurement(
        sums=sums.astype("<i4").tobytes(),
        valid=valid.astype(np.uint8).tobytes(),
        known=known.astype(np.uint8).tobytes(),
        states=states.astype(np.uint8).tobytes(),
        since_ns=np.zeros(phi.blocks, "<i8").tobytes(),
        **about | changed,
    )
