"""Format of the messages from the server to the page.

A frame is one binary WebSocket message: the length of the header as uint32, the header (the JSON of a
`health.snapshot.Snapshot` and ``pictures``, the names of the pictures that follow), spaces up to a multiple of
four bytes, then each picture as float32, shape (rows, columns), newtons. All little-endian.
"""

import struct
from typing import Any

import msgspec
import numpy as np

from health.notices import NMT_WORDS
from health.snapshot import Pictures, Snapshot
from skin.layout import Layout


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


def greeting(layout: Layout) -> dict[str, Any]:
    """Return the skin's constants for the page: sending, grid, buses, block of each taxel, names of the NMT states."""
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
        "force_max_n": taxels.force_max_n,
        "sums": layout.measurement.sums,
        "rate_hz": layout.sync.rate_hz,
        "blocks": layout.blocks,
        "block_of_taxel": np.where(phi.is_wired, phi.block_of_taxel, -1).tolist(),
        "buses": buses,
        "nmt": {str(int(state)): word for state, word in NMT_WORDS.items()},
    }
