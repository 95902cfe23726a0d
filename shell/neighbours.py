"""The other skins of this user's hub, whose names and serial numbers a layout may not have."""

import zlib
from contextlib import suppress
from typing import Final

from canskin.errors import BusError, InputError
from canskin.session import DEFAULT_ENDPOINT
from shell.service import say
from shell.skin_options import hub_layout, told_skins
from skin.layout import Layout
from skin.layout_keys import IDENTITY_MAX

#: Serial numbers of a new skin; no skin has as many blocks.
_SERIALS: Final = 1 << 16


def new_serial(name: str) -> int:
    """Return the serial number of the first board of a new skin: by its name, so that two new skins share none.

    Of ten skins two share numbers once in 1500 times: `tell_shared` looks.
    """
    return 1 + zlib.crc32(name.encode()) % (IDENTITY_MAX // _SERIALS) * _SERIALS


def require_new(name: str, endpoint: str = DEFAULT_ENDPOINT) -> None:
    """Raise InputError if a skin of this name is on a hub that is there now."""
    if name in told_skins(endpoint):
        raise InputError(
            f"skin '{name}' is at {endpoint} already: give a --out of another name, or stop its gateway and change its"
            " layout"
        )


def tell_shared(layout: Layout, service: str, endpoint: str = DEFAULT_ENDPOINT) -> None:
    """Log which skins on a hub that is there now have serial numbers of a layout."""
    own = layout.device.first_serial, layout.device.first_serial + layout.blocks - 1
    for name in told_skins(endpoint):
        with suppress(BusError):  # the skin has left
            other = hub_layout(endpoint, name)
            first = other.device.first_serial
            if name != layout.name and first <= own[1] and own[0] < first + other.blocks:
                say(
                    service,
                    f"serial numbers {own[0]} to {own[1]} are those of skin '{name}', too, and a board would be taken"
                    f" for one of the other skin: set device.first_serial, for example {new_serial(layout.name)}",
                )
