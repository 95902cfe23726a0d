"""Mean length of a frame with random data: expected stuff bits, computed without sampling.

The CRC of random data is random, so a classical frame consists of some known bits, random data and 15 random bits. The
stuffing rule depends only on the last bit and the length of its run: ten states, whose probabilities are updated bit by
bit.
"""

from functools import cache

import numpy as np
import numpy.typing as npt

from dbc.frame import BRS, FD, frames
from dbc.frame_bits import stuffed_bits, wire_bits

#: Longest run that stuffing allows.
RUN_MAX = 5
#: Probability of each last bit (row) and length of its run, 1 to 4 (column); a run of five gets a stuff bit at once.
State = npt.NDArray[np.float64]


@cache
def mean_wire_bits(length: int, flags: int = 0, can_id: int | None = None) -> tuple[float, float]:
    """Return the mean number of bits of a frame with random data, intermission included.

    Parameters
    ----------
    length : int
        Payload in bytes, without the padding of CAN FD.
    flags : int
        EXTENDED, FD, BRS and ESI of `dbc.frame`.
    can_id : int, optional
        Default: the mean over all identifiers.

    Returns
    -------
    nominal, data : float
        As `dbc.frame_bits.wire_bits`.
    """
    one = frames(1)
    one["length"], one["flags"] = length, flags
    nominal, data = (float(bits[0]) for bits in wire_bits(one, "none"))
    head, tail = stuffed_bits(length, flags, can_id)
    # The first fixed stuff bit of CAN FD replaces a dynamic stuff bit after the last data bit.
    stuff = _mean_stuff(head + tail, last=not flags & FD)
    in_head, in_tail = sum(stuff[: len(head)]), sum(stuff[len(head) :])
    if flags & BRS:
        return nominal + in_head, data + in_tail
    return nominal + in_head + in_tail, 0.0


def _mean_stuff(symbols: str, *, last: bool) -> list[float]:
    """Return the expected number of stuff bits after each bit; after the last bit only if `last`."""
    state = np.zeros((2, RUN_MAX - 1))
    expected = []
    for place, symbol in enumerate(symbols):
        is_end = place == len(symbols) - 1
        state, stuffed = _step(state, symbol, is_first=place == 0)
        expected.append(0.0 if is_end and not last else stuffed)
    return expected


def _step(state: State, symbol: str, *, is_first: bool) -> tuple[State, float]:
    """Apply one bit; return the next state and the probability of a stuff bit."""
    odds = (0.5, 0.5) if symbol == "?" else (float(symbol == "0"), float(symbol == "1"))
    following, stuffed = np.zeros_like(state), 0.0
    for bit, chance in enumerate(odds):
        following[bit, 0] += chance * (1.0 if is_first else state[1 - bit].sum())
        following[bit, 1:] += chance * state[bit, :-1]
        full = chance * float(state[bit, -1])
        following[1 - bit, 0] += full
        stuffed += full
    return following, stuffed
