"""Checks that a decoded message fits the skin shown: sizes and ranges."""

import math

import numpy as np

from canskin.messages import Contacts, GatewayStatus, Image, Label, Truth
from skin.layout import Layout
from skin.wall_times import END_NS

FLOAT_BYTES = 4
#: Most contacts of a message that the page shows.
MOST_CONTACTS = 256
#: Numbers of contacts end here: the clouds of ROS 2 have uint32.
IDENTITY_END = 2**32
#: Numbers of cycles end here: Rerun has int64.
CYCLE_END = 2**63


def image_fits(image: Image, layout: Layout) -> bool:
    """Tell whether an image has this skin's taxels and blocks, finite forces, and a time and a cycle in range."""
    return (
        len(image.valid) == layout.blocks
        and _pixels_fit(image.pixels, layout)
        and math.isfinite(image.solve_s)
        and _moment_fits(image)
    )


def truth_fits(truth: Truth, layout: Layout) -> bool:
    """Tell whether a truth has this skin's taxels, and finite forces."""
    return _pixels_fit(truth.true, layout) and _pixels_fit(truth.sensor, layout)


def contacts_fit(contacts: Contacts, layout: Layout) -> bool:
    """Tell whether every contact has its centre on this skin, finite forces, and numbers, time and cycle in range."""
    taxels = layout.taxels
    return (
        len(contacts.contacts) <= MOST_CONTACTS
        and _moment_fits(contacts)
        and all(
            0 <= each.row < taxels.rows
            and 0 <= each.column < taxels.columns
            and math.isfinite(each.force_n)
            and math.isfinite(each.peak_n)
            and 0 <= each.identity < IDENTITY_END
            and 0 <= each.taxels <= taxels.count
            and 0 <= each.invalid_taxels <= taxels.count
            for each in contacts.contacts
        )
    )


def label_fits(label: Label) -> bool:
    """Tell whether a label's confidence is within 0 to 1, and its time and cycle are in range."""
    return 0.0 <= label.confidence <= 1.0 and _moment_fits(label)


def status_fits(status: GatewayStatus) -> bool:
    """Tell whether every bus has a state for each of its nodes, and every figure is a number."""
    numbers = [status.sync_rate_hz, *(load for bus in status.buses for load in (bus.load_ratio, bus.mean_load_ratio))]
    return all(len(bus.nmt) == len(bus.nodes) for bus in status.buses) and all(map(math.isfinite, numbers))


def _moment_fits(message: Image | Contacts | Label) -> bool:
    return 0 <= message.sampled_mono_ns < END_NS and 0 <= message.cycle < CYCLE_END


def _pixels_fit(pixels: bytes, layout: Layout) -> bool:
    if len(pixels) != layout.taxels.count * FLOAT_BYTES:
        return False
    return bool(np.isfinite(np.frombuffer(pixels, "<f4")).all())
