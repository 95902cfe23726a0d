"""The description of a layout for programs, which the gateway gives."""

import numpy as np

from canskin.description import Description
from canskin.skin_clock import machine
from skin.layout import Layout


def describe(layout: Layout) -> Description:
    """Return what a program has to know of a skin."""
    phi, taxels = layout.phi(), layout.taxels
    surface = taxels.surface
    return Description(
        name=layout.name,
        rows=taxels.rows,
        columns=taxels.columns,
        pitch_m=surface.pitch_m,
        blocks=phi.blocks,
        sums=phi.shape[0],
        order=phi.order.astype("<u4").tobytes(),
        kept=phi.kept.astype("u1").tobytes(),
        newton_per_count=taxels.newton_per_count,
        force_max_n=taxels.force_max_n,
        rate_hz=layout.sync.rate_hz if layout.sends.in_cycles else layout.samples_per_sync * layout.sync.rate_hz,
        sending=layout.sending,
        fingerprint=phi.fingerprint,
        boot_id=machine(),
        is_grid=surface.is_grid,
        positions=surface.positions_m.astype("<f4").tobytes(),
        normals=surface.normals.astype("<f4").tobytes(),
        masked=np.flatnonzero(taxels.is_masked).astype("<u4").tobytes(),
    )
