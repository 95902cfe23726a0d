"""Format of the messages from the server to the page.

A frame is one binary WebSocket message: the length of the header as uint32, the header (the JSON of a
`health.snapshot.Snapshot` and ``pictures``, the names of the pictures that follow), spaces up to a multiple of
four bytes, then each picture as float32, shape (rows, columns), newtons. All little-endian.
"""

import struct
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np

from health.nodes_why import NMT_WORDS
from health.snapshot import Pictures, Snapshot
from skin.layout import Layout
from skin.plane import view_of
from skin.regions import regions_of
from skin.surface import Surface


def frame(snapshot: Snapshot, pictures: Pictures) -> bytes:
    """Return the frame of a snapshot and its pictures."""
    there = {
        name: picture
        for name, picture in (("image", pictures.image), ("true", pictures.true), ("sensor", pictures.sensor))
        if picture is not None
    }
    header = msgspec.json.encode({"pictures": list(there), "snapshot": snapshot})
    header += b" " * (-len(header) % 4)
    content = (np.ascontiguousarray(picture, "<f4").tobytes() for picture in there.values())
    return b"".join((struct.pack("<I", len(header)), header, *content))


def greeting(layout: Layout, actions: Sequence[str] = ()) -> dict[str, Any]:
    """Return the skin's constants for the page: sending, taxels, buses, block of each taxel, names of the NMT states.

    ``actions`` are the names of what the page may ask for, ``regions`` those of parts of the skin.
    ``surface`` is None of a grid. Else it has positions and normals; `skin.plane.view_of` at first; what is then in the
    middle; and the space that the skin needs, in pitches, if it is turned to any side unless it is flat.
    """
    taxels, phi = layout.taxels, layout.phi()
    buses = [
        {
            "name": bus.name,
            "nodes": bus.nodes,
            "bitrate": bus.bitrate,
            "data_bitrate": bus.data_bitrate if bus.fd else None,
            "first_block": layout.first_block(place),
            "blocks_per_node": bus.blocks_per_node,
        }
        for place, bus in enumerate(layout.bus)
    ]
    return {
        "skin": layout.name,
        "sending": layout.sending,
        "rows": taxels.rows,
        "columns": taxels.columns,
        "surface": None if taxels.surface.is_grid else _surface(taxels.surface),
        "force_max_n": taxels.force_max_n,
        "sums": layout.measurement.sums,
        "rate_hz": layout.sync.rate_hz,
        "blocks": layout.blocks,
        "block_of_taxel": np.where(phi.is_wired, phi.block_of_taxel, -1).tolist(),
        "masked": list(taxels.masked or ()),
        "buses": buses,
        "actions": list(actions),
        "regions": [each.name for each in regions_of(layout)[1:]],
        "nmt": {str(int(state)): word for state, word in NMT_WORDS.items()},
    }


def _surface(surface: Surface) -> dict[str, Any]:
    view = view_of(surface)
    seen = surface.positions_m @ view.T
    middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
    width, height, _ = np.ptp(seen, axis=0) / surface.pitch_m + 1.0
    if not surface.is_flat:
        width = height = 2.0 * np.linalg.norm(seen - middle, axis=1).max() / surface.pitch_m + 1.0
    return {
        "positions_m": surface.positions_m.round(6).tolist(),
        "normals": surface.normals.round(4).tolist(),
        "pitch_m": surface.pitch_m,
        "view": view.tolist(),
        "middle_m": (middle @ view).tolist(),
        "is_flat": surface.is_flat,
        "width": float(width),
        "height": float(height),
    }
