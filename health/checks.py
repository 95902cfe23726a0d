"""Checks that a decoded message fits the skin shown: sizes and ranges."""

import math
from itertools import chain

import msgspec
import numpy as np

from canskin.messages import Contact, Contacts, GatewayStatus, Image, Label, Mark, ServiceStatus, Truth, is_label
from skin.layout import Layout
from skin.wall_times import END_NS

FLOAT_BYTES = 4
#: Numbers of contacts end here: the clouds of ROS 2 have float32.
FLOAT_MAX = float(np.finfo(np.float32).max)
#: Most contacts of a message that the page shows.
MOST_CONTACTS = 256
#: Identities of contacts end here: the clouds of ROS 2 have uint32.
IDENTITY_END = 2**32
#: Numbers of cycles end here: Rerun has int64.
CYCLE_END = 2**63


def fits(message: msgspec.Struct, layout: Layout) -> bool:
    """Tell whether a message has this skin's sizes, and only numbers that programs can show.

    Images and truths: finite forces of this skin's taxels; times and cycles in range. Contacts: centres on this skin,
    finite forces, numbers in range. Labels: a confidence of 0 to 1. Marks: a name that an object can have. Counters of
    the gateway: a state of each node. Times of services: finite.
    """
    match message:
        case Image():
            return (
                len(message.valid) == layout.blocks
                and len(message.doubtful) in {0, (layout.taxels.count + 7) // 8}
                and _pixels_fit(message.pixels, layout)
                and math.isfinite(message.solve_s)
                and _moment_fits(message)
            )
        case Truth():
            return _pixels_fit(message.true, layout) and _pixels_fit(message.sensor, layout)
        case Contacts():
            found = message.contacts
            return (
                max(len(found), len(message.ended)) <= MOST_CONTACTS
                and math.isfinite(message.find_s)
                and _moment_fits(message)
                and all(_contact_fits(each, layout) for each in found)
            )
        case Label():
            return 0.0 <= message.confidence <= 1.0 and _moment_fits(message)
        case GatewayStatus():
            numbers = [message.sync_rate_hz, message.heartbeat_limit_s, message.answer_limit_s]
            for bus in message.buses:
                numbers += [bus.load_ratio, bus.mean_load_ratio, *chain(*bus.answer_s, *bus.heartbeat_s)]
            has_states = all(len(bus.nmt) == len(bus.nodes) for bus in message.buses)
            return has_states and all(map(math.isfinite, numbers))
    is_finite = not isinstance(message, ServiceStatus) or math.isfinite(message.processor_s)
    return is_finite and (not isinstance(message, Mark) or is_label(message.label))


def _contact_fits(contact: Contact, layout: Layout) -> bool:
    taxels = layout.taxels
    floats = contact.force_n, contact.peak_n, *contact.position_m, *contact.normal
    return (
        0 <= contact.row < taxels.rows
        and 0 <= contact.column < taxels.columns
        and all(abs(each) <= FLOAT_MAX for each in floats)
        and 0 <= contact.identity < IDENTITY_END
        and 0 <= contact.taxels <= taxels.count
        and 0 <= contact.invalid_taxels <= taxels.count
    )


def _moment_fits(message: Image | Contacts | Label) -> bool:
    return 0 <= message.sampled_mono_ns < END_NS and 0 <= message.cycle < CYCLE_END


def _pixels_fit(pixels: bytes, layout: Layout) -> bool:
    if len(pixels) != layout.taxels.count * FLOAT_BYTES:
        return False
    return bool(np.isfinite(np.frombuffer(pixels, "<f4")).all())
