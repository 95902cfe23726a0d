"""Checks that a decoded message fits the skin shown: sizes and ranges."""

import math

import numpy as np

from canskin.messages import Contacts, GatewayStatus, Image, Label, Truth
from skin.layout import Layout

FLOAT_BYTES = 4
#: Most contacts of a message that the page shows.
MOST_CONTACTS = 256


def image_fits(image: Image, layout: Layout) -> bool:
    """Tell whether an image has this skin's taxels and blocks, and finite forces."""
    return len(image.valid) == layout.blocks and _pixels_fit(image.pixels, layout) and math.isfinite(image.solve_s)


def truth_fits(truth: Truth, layout: Layout) -> bool:
    """Tell whether a truth has this skin's taxels, and finite forces."""
    return _pixels_fit(truth.true, layout) and _pixels_fit(truth.sensor, layout)


def contacts_fit(contacts: Contacts, layout: Layout) -> bool:
    """Tell whether every contact has its centre on this skin, and a finite force."""
    rows, columns = layout.taxels.rows, layout.taxels.columns
    return len(contacts.contacts) <= MOST_CONTACTS and all(
        0 <= each.row < rows and 0 <= each.column < columns and math.isfinite(each.force_n)
        for each in contacts.contacts
    )


def label_fits(label: Label) -> bool:
    """Tell whether a label's confidence is within 0 to 1."""
    return 0.0 <= label.confidence <= 1.0


def status_fits(status: GatewayStatus) -> bool:
    """Tell whether every bus has a state for each of its nodes, and every figure is a number."""
    numbers = [status.sync_rate_hz, *(load for bus in status.buses for load in (bus.load_ratio, bus.mean_load_ratio))]
    return all(len(bus.nmt) == len(bus.nodes) for bus in status.buses) and all(map(math.isfinite, numbers))


def _pixels_fit(pixels: bytes, layout: Layout) -> bool:
    if len(pixels) != layout.taxels.count * FLOAT_BYTES:
        return False
    return bool(np.isfinite(np.frombuffer(pixels, "<f4")).all())
