"""Frames of a recorded bus, from any log that python-can reads, and of a live one."""

import re
import select
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

import can
import numpy as np
from can.io.blf import BLFParseError

from bus.link import DISCARDED, Link
from bus.messages import to_logged_frames
from dbc.frame import Frames, frames
from skin.errors import InputError
from skin.layout import Layout

#: What damaged logs raise in python-can's readers.
_UNREADABLE: Final = (
    OSError,
    EOFError,
    OverflowError,
    ValueError,
    TypeError,
    IndexError,
    KeyError,
    AttributeError,
    ImportError,
    NotImplementedError,
    struct.error,
    can.CanError,
    BLFParseError,
)
_TURN_S: Final = 0.2


def read_log(path: Path) -> dict[str, Frames]:
    """Return the frames of a log by channel, in its order, with times in nanoseconds.

    Parameters
    ----------
    path : pathlib.Path
        ``.log`` (candump -l), ``.asc``, ``.blf``, ``.trc``, ``.csv``, ``.db`` or, with asammdf installed, ``.mf4``.

    Raises
    ------
    InputError
        If the file cannot be read, or holds no frame.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such log")
    of_channel: dict[str, list[can.Message]] = {}
    try:
        with can.LogReader(path) as reader:
            for message in reader:
                of_channel.setdefault(str(message.channel), []).append(message)
        logged = {channel: to_logged_frames(messages) for channel, messages in of_channel.items()}
    except _UNREADABLE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot be read as a log of CAN frames: {reason}") from error
    if not logged:
        raise InputError(f"{path}: holds no CAN frame")
    return logged


def listen(links: dict[int, Link], seconds: float, stopped: Callable[[], bool]) -> dict[int, Frames]:
    """Return what every bus carries for `seconds`, or until `stopped`, by the number of its link."""
    arrived: dict[int, list[Frames]] = {number: [frames(0)] for number in links}
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0 and not stopped():
        select.select(list(links.values()), [], [], min(left_s, _TURN_S))
        for number, link in links.items():
            seen = link.receive()
            arrived[number].append(seen[seen["flags"] & DISCARDED != DISCARDED])
    return {number: np.concatenate(seen) for number, seen in arrived.items()}


def of_buses(
    layout: Layout, names: list[str], logged: dict[str, Frames], path: Path, *, named_by_user: bool = False
) -> dict[int, Frames]:
    """Assign the channels of a log to the buses of a layout.

    Those that bear one of `names` (one per bus) go by their name; if none does, all go in their natural order.

    Raises
    ------
    InputError
        If there are more channels than buses, or none of those that the user named.
    """
    named = {number: logged[name] for number, name in enumerate(names) if name in logged}
    if named:
        return named
    if named_by_user:
        raise InputError(f"{path}: expected a channel of {', '.join(names)}, the log holds {', '.join(logged)}")
    if len(logged) > len(layout.bus):
        raise InputError(
            f"{path}: expected up to {len(layout.bus)} channels, one per bus of the layout, got {', '.join(logged)}; "
            "name those of the skin with -c"
        )
    return {number: logged[name] for number, name in enumerate(sorted(logged, key=_natural))}


def _natural(name: str) -> list[tuple[int, str]]:
    """Order can10 behind can9."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
