"""Frames of a bus, from a log that python-can reads or from a live bus."""

import re
import select
import time
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Final

import can
import numpy as np
import numpy.typing as npt

from bandwidth.log_file import LogFile, open_log
from bandwidth.measured import JUMP_NS
from bus.link import DISCARDED, Link
from bus.messages import to_logged_frames
from canskin.errors import InputError
from dbc.canopen import EXTENDED_ID_MASK
from dbc.frame import Frames, frames
from dbc.stored_frames import from_bytes
from recording import file_of, is_recording
from skin.layout import Layout

#: Largest time stamp, seconds since the epoch: in 2261, a year before nanoseconds end that 64 bits hold.
_LATEST_S: Final = 9.2e9
#: Frames of one channel are out of order by less, as adapters deliver them: their times stand still.
_DISORDER_NS: Final = 10_000_000
#: Frames of several channels are out of order by less.
_CHANNELS_NS: Final = 100_000_000
#: A log has at most a frame for two of its bytes, or this many: more only of a file that unpacks to thousands of times
#: its size.
_FRAMES_MAX: Final = 2**16
#: Period of the check whether to end a live measurement.
_TURN_S: Final = 0.2


def read_log(path: Path, warn: Callable[[str], None]) -> dict[str, Frames]:
    """Return the frames of a log by channel, in its order, with times in nanoseconds.

    A log that ends inside a line or a container, as after a power failure, is read up to there. Of a log whose times
    fall, the longest part is read in which they do not. InputError names the place of any other error.

    Parameters
    ----------
    path : pathlib.Path
        ``.mcap`` of ``skin record``, ``.log`` (candump -l), ``.asc``, ``.blf``, ``.trc``, ``.csv``, ``.db`` or, with
        asammdf installed, ``.mf4``. A log of candump may have any other suffix.
    warn : callable
        Receives a line of text for each cause why the log is not whole, and where its times jump.
    """
    if not file_of(path).is_file():
        raise InputError(f"{path}: no such log")
    if is_recording(path):
        return _read_recording(path, warn)
    found: list[can.Message] = []
    places: list[int] = []
    log: LogFile | None = None
    try:
        with open_log(path) as log:
            for message in _limited(log, max(_FRAMES_MAX, path.stat().st_size // 2)):
                _check(message)
                found.append(message)
                places.append(log.number)
    except Exception as error:  # the readers raise anything on a damaged file
        where = f"{path}, {log.unit} {log.number}" if log is not None and log.number else f"{path}"
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{where}: cannot be read as a log of CAN frames: {reason}") from error
    for line in log.missing():
        warn(f"{path}: {line}")
    if not found:
        raise InputError(f"{path}: holds no CAN frame")
    names, channels = np.unique([str(message.channel) for message in found], return_inverse=True)
    logged = to_logged_frames(found)
    told = partial(_told, warn, path)
    return _forward(logged, channels, names.tolist(), lambda each: f"{log.unit} {places[each]}", told)


def _told(warn: Callable[[str], None], path: Path, line: str) -> None:
    warn(f"{path}, {line}")


def _forward(
    logged: Frames,
    channels: npt.NDArray[np.intp],
    names: list[str],
    at: Callable[[int], str],
    tell: Callable[[str], None],
) -> dict[str, Frames]:
    """Return the frames by channel, of the longest part of a log in which the times of no channel fall.

    Parameters
    ----------
    channels : array (n,)
        For each frame the place of its channel in `names`.
    at : callable
        Returns the place of a frame, by its number from 0.
    tell : callable
        Receives a line of text if times fall, jump, or are those of several clocks.
    """
    times_ns = logged["time_ns"]
    own_steps_ns = np.zeros(len(times_ns), np.int64)
    for channel in range(len(names)):
        mine = np.flatnonzero(channels == channel)
        own_steps_ns[mine[1:]] = np.diff(times_ns[mine])
    falls = np.flatnonzero(own_steps_ns < 0)
    if len(falls) > len(times_ns) // 8:
        count = f"{len(falls)} of {len(times_ns)} times fall"
        tell(f"{at(int(falls[0]))}: {count}: are they those since the frame before, as of 'candump -td'?")
    falls = falls[own_steps_ns[falls] < -_DISORDER_NS]
    edges = np.concatenate(([0], falls, [len(times_ns)]))
    longest = int(np.argmax(np.diff(edges)))
    first, end = int(edges[longest]), int(edges[longest + 1])
    if len(falls):
        what = f"the time of channel {names[channels[falls[0]]]} falls by {-own_steps_ns[falls[0]] * 1e-9:.6g} s"
        used = f"{end - first} of {len(times_ns)} frames, where it does not, are read from {at(first)} on"
        tell(f"{at(int(falls[0]))}: {what}{_more(falls)}: {used}")
    logged, times_ns, channels = logged[first:end], times_ns[first:end], channels[first:end]
    newest_ns = np.maximum.accumulate(times_ns)
    steps_ns = np.diff(newest_ns)
    jumps = np.flatnonzero((steps_ns > JUMP_NS) & (own_steps_ns[first + 1 : end] > JUMP_NS))
    if len(jumps):
        place = at(first + int(jumps[0]) + 1)
        tell(f"{place}: the time jumps by {steps_ns[jumps[0]] * 1e-9:.6g} s{_more(jumps)}")
    behind_ns = newest_ns - times_ns
    worst = int(np.argmax(behind_ns))
    if behind_ns[worst] > _CHANNELS_NS:
        late = f"channel {names[channels[worst]]} is {behind_ns[worst] * 1e-9:.6g} s behind the others"
        tell(f"{at(first + worst)}: {late}: have the channels two clocks?")
    found = {name: logged[channels == each] for each, name in enumerate(names) if each in channels}
    for seen in found.values():
        seen["time_ns"] = np.maximum.accumulate(seen["time_ns"])
    return found


def _more(places: npt.NDArray[np.intp]) -> str:
    return f", and {len(places) - 1} times more" if len(places) > 1 else ""


def _limited(messages: Iterable[can.Message], most: int) -> Iterator[can.Message]:
    for number, message in enumerate(messages):
        if number == most:
            raise ValueError(f"expected at most {most} frames in a file of this size, got more")
        yield message


def _read_recording(path: Path, warn: Callable[[str], None]) -> dict[str, Frames]:
    """Return the frames of a recording by the name of their bus."""
    from recording.mcap_file import FRAMES, read_entries, wall_offset_ns

    parts: dict[str, list[Frames]] = {}
    offset_ns = wall_offset_ns(path)
    for entry in read_entries(path, warn):
        if entry.topic.startswith(FRAMES) and entry.data:
            part = from_bytes(entry.data, int(entry.about["data_bytes"]))
            part["time_ns"] += offset_ns
            parts.setdefault(entry.topic.removeprefix(FRAMES), []).append(part)
    if not parts:
        raise InputError(f"{path}: holds no CAN frame")
    found: dict[str, Frames] = {}
    for name, each in parts.items():
        logged, told = np.concatenate(each), partial(_told, warn, path)
        found |= _forward(logged, np.zeros(len(logged), np.intp), [name], partial(_frame_of, name), told)
    return found


def _frame_of(name: str, place: int) -> str:
    return f"frame {place + 1} of {name}"


def _check(message: can.Message) -> None:
    """Refuse impossible frames, and set the length of a classic frame whose DLC is above 8."""
    longest = 64 if message.is_fd else 8
    if not 0 <= message.timestamp <= _LATEST_S:
        raise ValueError(f"a time of {message.timestamp:g} s")
    if not 0 <= message.arbitration_id <= EXTENDED_ID_MASK:
        raise ValueError(f"an identifier of {message.arbitration_id:X}h")
    if message.dlc < 0 or len(message.data) > longest:
        raise ValueError(f"a frame of {max(message.dlc, len(message.data))} bytes")
    if message.is_fd:  # its readers give the DLC of some formats, and take frames without data for remote frames
        message.is_remote_frame, message.dlc = False, len(message.data)
    message.dlc = min(message.dlc, longest)
    if len(message.data) != message.dlc and not (message.is_remote_frame or message.is_error_frame):
        raise ValueError(f"a frame of {message.dlc} bytes, of which the log holds {len(message.data)}")
    message.is_extended_id &= not message.is_error_frame  # of some formats alone


def listen(links: dict[int, Link], seconds: float, stopped: Callable[[], bool]) -> dict[int, Frames]:
    """Return the frames of every bus during `seconds`, or until `stopped`, by the number of its link."""
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

    Channels with one of `names` (one per bus) are assigned by name; if there is none, all are assigned in natural
    order. Raise InputError if channels are left over, or none has a name that the user gave.
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
    """Sort key: can10 comes after can9."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
