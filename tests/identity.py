"""The two ways to know a frame's cycle (`sync.identity`)."""

from typing import Final

import msgspec

from skin.layout import Layout, Sync

IDENTITIES: Final = ("window", "alternating")


def with_identity(layout: Layout, identity: str) -> Layout:
    """Return the layout with another identity of cycles."""
    return msgspec.structs.replace(
        layout, sync=msgspec.convert({"rate_hz": layout.sync.rate_hz, "identity": identity}, Sync)
    )


def alternating(layout: Layout) -> Layout:
    """Return the layout with one set of TPDOs for odd and one for even cycles."""
    return with_identity(layout, "alternating")
