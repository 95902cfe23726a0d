"""Bits of a frame and its time on the bus, exact or bounded.

Three ways to count the stuff bits, in the words of can-utils:

``none``
    No stuff bits: the lower bound of a frame.
``worst``
    The most stuff bits of any identifier and payload of this length.
``exact``
    The stuff bits of the frame's own identifier and payload.

Every count includes the three bits of intermission, so counts of consecutive frames can be added.
"""

from functools import cache
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from dbc.frame import (
    BASE_BITS,
    BRS,
    CLASSIC_BYTES,
    CLASSIC_TAIL,
    ERROR,
    ESI,
    EXTENDED,
    EXTENDED_BITS,
    FD,
    FD_LENGTHS,
    REMOTE,
    Frames,
    frame_bytes,
)

Stuffing = Literal["none", "worst", "exact"]
Bits = npt.NDArray[np.int32]

#: Intermission, counted into every frame.
INTERMISSION_BITS: Final = 3

#: DLC of a frame by its number of bytes, and the number of bytes that this DLC stands for.
DLC: Final = np.searchsorted(FD_LENGTHS, np.arange(256)).clip(max=15).astype(np.int32)
PADDED: Final = np.array(FD_LENGTHS, np.int32)[DLC]
_FD_NOMINAL_TAIL: Final = 12


def padded_length(lengths: npt.NDArray[np.integer]) -> Bits:
    """Return the payload bytes of CAN FD frames with padding: the next length that has a DLC."""
    padded: Bits = PADDED[lengths]
    return padded


def wire_bits(frames: Frames, stuffing: Stuffing = "exact") -> tuple[Bits, Bits]:
    """Count the bits of frames, intermission included.

    Parameters
    ----------
    frames : array of FRAME, shape (n,)
        ERROR records count 0 bits: they are reports, not frames.

    Returns
    -------
    nominal, data : arrays of int32, shape (n,)
        Bits at the nominal and at the data bit rate. `data` is 0 for classical frames and for CAN FD
        frames without BRS. The bits of BRS and of the CRC delimiter, which change rate at their sample
        points, are counted as nominal and as data.

    Notes
    -----
    Classical frames: Davis, Burns, Bril, Lukkien, Real-Time Systems 35 (2007), equation 1; exact by the
    bit string SOF to CRC. CAN FD: ISO 11898-1:2015 with stuff bit count and fixed stuff bits.
    """
    flags = frames["flags"]
    if stuffing == "exact":
        from dbc.stuff_bits import count_all

        nominal, data = np.empty((2, len(frames)), np.int32)
        count_all(frame_bytes(frames), nominal, data)
        return nominal, data
    is_fd = flags & FD != 0
    nominal, data = fixed_bits(flags, frames["length"])
    if stuffing == "worst":
        stuff = _worst_stuff(frames, is_fd)
        nominal += stuff[0]
        data += stuff[1]
    slow = is_fd & (flags & BRS == 0)
    if slow.any():
        nominal[slow] += data[slow]
        data[slow] = 0
    reports = flags & ERROR != 0
    if reports.any():
        nominal[reports] = 0
        data[reports] = 0
    return nominal, data


def frame_time_ns(
    frames: Frames, bitrate: int, data_bitrate: int | None = None, stuffing: Stuffing = "exact"
) -> npt.NDArray[np.int64]:
    """Return the time of each frame on the bus, intermission included.

    Parameters
    ----------
    frames : array of FRAME, shape (n,)
    bitrate, data_bitrate : int
        Bits per second; without `data_bitrate` the whole frame has `bitrate`.

    Returns
    -------
    array of int64, shape (n,)
        Nanoseconds, rounded to the nearest.
    """
    if stuffing == "exact":
        from dbc.stuff_bits import write_times

        times_ns = np.empty(len(frames), np.int64)
        write_times(frame_bytes(frames), bitrate, data_bitrate or bitrate, times_ns)
        return times_ns
    nominal, data = wire_bits(frames, stuffing)
    seconds = nominal / bitrate + data / (data_bitrate or bitrate)
    return np.rint(seconds * 1e9).astype(np.int64)


def nominal_ns(bits: int, bitrate: int) -> int:
    """Return the time of `bits` at the nominal bit rate in nanoseconds, rounded."""
    return round(bits * 1e9 / bitrate)


def stuffed_bits(length: int, flags: int, can_id: int | None = None) -> tuple[str, str]:
    """Return the bits to which dynamic stuffing applies, as 0, 1 or ? for any, before and after the bit-rate switch.

    `can_id` None is any identifier. The CRC of a classic frame is any.
    """
    known = "?" * 29 if can_id is None else f"{can_id:029b}"
    base, extension = (known[:11], known[11:]) if flags & EXTENDED else (known[-11:], "")
    fd = flags & FD
    # SOF, identifier, RTR (SRR) and IDE; of an extended identifier its second part and RTR; FDF and reserved bits
    head = "0" + base + ("11" + extension + "0" if flags & EXTENDED else "00")
    head += "10" if fd else "00" if flags & EXTENDED else "0"
    switches = f"{int(bool(flags & BRS))}{int(bool(flags & ESI))}" if fd else ""
    return head, switches + f"{DLC[length]:04b}" + "?" * (8 * int(PADDED[length]) + (0 if fd else 15))


def fixed_bits(flags: npt.NDArray[np.integer], length: npt.NDArray[np.integer]) -> tuple[Bits, Bits]:
    """Count all bits of frames except dynamic stuff bits, as `wire_bits` of frames with BRS."""
    is_fd, extended = flags & FD != 0, flags & EXTENDED != 0
    payload = np.where(flags & REMOTE, 0, np.minimum(length, CLASSIC_BYTES)).astype(np.int32)
    nominal = np.where(extended, EXTENDED_BITS, BASE_BITS).astype(np.int32) + 8 * payload + CLASSIC_TAIL
    data = np.zeros_like(nominal)
    if is_fd.any():
        padded = PADDED[length]
        head = np.where(extended, 36, 17)
        # ESI, DLC, payload, stuff count, CRC 17 or 21 with its fixed stuff bits, CRC delimiter
        body = 5 + 8 * padded + np.where(padded <= 16, 4 + 17 + 6, 4 + 21 + 7) + 1
        nominal[is_fd] = (head + _FD_NOMINAL_TAIL)[is_fd]
        data[is_fd] = body[is_fd]
    return nominal, data


def _worst_stuff(frames: Frames, is_fd: npt.NDArray[np.bool_]) -> tuple[Bits, Bits]:
    flags = frames["flags"]
    payload = np.where(flags & REMOTE, 0, np.minimum(frames["length"], CLASSIC_BYTES)).astype(np.int32)
    nominal = (np.where(flags & EXTENDED, EXTENDED_BITS, BASE_BITS).astype(np.int32) + 8 * payload - 1) // 4
    data = np.zeros_like(nominal)
    for index in np.flatnonzero(is_fd):
        shape = int(flags[index]) & (EXTENDED | BRS | ESI)
        nominal[index], data[index] = _worst_fd(shape, int(DLC[frames["length"][index]]))
    return nominal, data


@cache
def _worst_fd(shape: int, dlc: int) -> tuple[int, int]:
    """Find the most dynamic stuff bits of a CAN FD frame over all identifiers and payloads.

    Dynamic programming over the frame's bits, where free bits take both values. The state is the last bit and the
    length of its run. Nominal stuff bits are slow, so their number is maximised first.
    """
    fixed = {bit: int(bit == "1") for bit in "01"}
    head, tail = stuffed_bits(FD_LENGTHS[dlc], shape | FD)
    best: dict[tuple[int, int], tuple[int, int]] = {(2, 0): (0, 0)}
    for place, symbol in enumerate(head + tail):
        in_head, is_last = place < len(head), place == len(head + tail) - 1
        following: dict[tuple[int, int], tuple[int, int]] = {}
        for (last, run), (nominal, data) in best.items():
            for bit in (fixed[symbol],) if symbol in fixed else (0, 1):
                length = run + 1 if bit == last else 1
                stuff = length == 5 and not is_last  # the first fixed stuff bit replaces a dynamic one
                state = (1 - bit, 1) if stuff else (bit, length)
                count = (nominal + (stuff and in_head), data + (stuff and not in_head))
                following[state] = max(following.get(state, (0, 0)), count)
        best = following
    return max(best.values())
