"""How adaptive nodes put sums into frames: coarse and fine codes, and identifiers that carry urgency.

A *coarse* frame carries the eight sums of a group, each as a companded byte that needs no earlier frame. A *fine* frame
refines the values of the newest coarse frame of its group: seven bits of each sum, and a check that tells which coarse
frame it belongs to.
"""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from skin.compiled import njit
from skin.walsh import GROUPS

#: Sums of a group, one byte each in a coarse frame.
GROUP_SUMS: Final = 8
#: Sums of a block.
BLOCK_SUMS: Final = GROUPS * GROUP_SUMS
#: Urgency levels of coarse frames, 0 the lowest, and of fine frames.
LEVELS: Final = 6
FINE_LEVELS: Final = 2
#: Frames of each kind and level that a node owns: its TPDOs.
TPDOS: Final = GROUPS * (LEVELS + FINE_LEVELS)
#: Nodes of a bus: each owns one identifier in `NODES` for each TPDO.
NODES: Final = 32
#: COB-ID of the first TPDO of node 1; those of all nodes end at 580h, below the SDO answers.
FIRST_COB_ID: Final = 0x181
#: No TPDO starts in this time after a SYNC, so that SDO answers and heartbeats find room on a full bus.
PAUSE_MS: Final = 2
#: A budget of bits can be saved up for so long, and for so many frames at least.
SAVING_S: Final = 0.25
SAVED_FRAMES: Final = 2 * GROUPS
#: Largest codes of the mean row, and on each side of 0 of the other rows.
MEAN_CODES: Final = 255
OTHER_CODES: Final = 127
#: The codes reach their range with one code to spare.
_SPARE: Final = 1
#: Bits of a sum in a fine frame, and the difference that they can tell, in fine steps to each side.
FINE_BITS: Final = 7
FINE_REACH: Final = 1 << FINE_BITS - 1
#: A node sends a fine frame when no sum is further from its coarse value, in fine steps.
FINE_LIMIT: Final = FINE_REACH - 2
#: Coarse steps near 0 that a fine step divides.
FINE_PER_COARSE: Final = 8
#: x^8 + x^5 + x^3 + x^2 + x + 1 (the code of AUTOSAR's CRC8H2F): detects every change of one byte and of up to three
#: bits, and 254 of 255 changes of two bytes.
_CRC_8: Final = 0x2F

Bytes = npt.NDArray[np.uint8]


class SendingRule(NamedTuple):
    """When sums are sent; times in samples of 1 ms.

    A group is news when the squared difference between its sums and those that were sent exceeds the threshold
    ``8 · 32 · (noise_ratio · σ)² + variance_ratio · Σ Var``, σ the node's noise. Differences below `rounding` coarse
    steps do not count.

    Attributes
    ----------
    noise_ratio, variance_ratio, rounding : float
    level_ratio : float
        A level of urgency stands for this many doublings of difference over threshold.
    doubling : float
        Waiting for so long counts as twice the difference.
    inhibit : int
        Least time between two frames of a group (the TPDOs' inhibit time).
    fine_ratio : float
        Part of the noise's threshold that a difference of details has to exceed.
    fine_wait : int
        Least time from any frame of a group to its next frame of details.
    refresh, refresh_max : int
        A group is sent again after this time, which doubles with each repetition.
    overdue : int
        A refresh that waits so long goes up one level.
    zero_refreshes : int
        A group at zero is sent again so often.
    patience : int
        News that has waited for so long has the highest level, and no other news has.
    """

    noise_ratio: float = 0.15
    variance_ratio: float = 4.0
    rounding: float = 0.75
    level_ratio: float = 1.25
    doubling: float = 8.0
    inhibit: int = 1
    fine_ratio: float = 0.3
    fine_wait: int = 4
    refresh: int = 64
    refresh_max: int = 1024
    overdue: int = 100
    zero_refreshes: int = 6
    patience: int = 24


class Companding(NamedTuple):
    """The code of coarse frames: ``code = round(slope · asinh(value / knee))``.

    Attributes
    ----------
    mean_slope, mean_knee_n : float
        Of the first row, the sum of all taxels, never negative: codes 0 to 255.
    slope, knee_n : float
        Of all other rows: codes 128 - 127 to 128 + 127, 128 for 0.
    fine_n : float
        Step of a fine frame, newtons.
    """

    mean_slope: float
    mean_knee_n: float
    slope: float
    knee_n: float
    fine_n: float


def companding(force_max_n: float, step_n: float, taxels: int = BLOCK_SUMS) -> Companding:
    """Return the code of blocks of `taxels` taxels: steps of `step_n` near 0, and a range that no sum leaves.

    Parameters
    ----------
    force_max_n : float
        Full scale of a taxel, newtons: the mean row reaches `taxels` times as far, every other row half of that.
    step_n : float
        Coarse step near 0, newtons.
    """
    top_n = taxels * force_max_n
    mean = _slope(top_n / step_n, MEAN_CODES - _SPARE)
    other = _slope(top_n / 2 / step_n, OTHER_CODES - _SPARE)
    return Companding(mean, mean * step_n, other, other * step_n, step_n / FINE_PER_COARSE)


def _slope(steps: float, codes: int) -> float:
    """Return the a of a · asinh(steps / a) = codes; steps / codes is how much the last step exceeds the first."""
    low, high = 1e-3, 1e9
    for _ in range(200):
        middle = math.sqrt(low * high)
        if middle * math.asinh(steps / middle) < codes:
            low = middle
        else:
            high = middle
    return low


@njit(cache=True, nogil=True)
def tpdo_index(level: int, group: int, is_fine: bool) -> int:
    """Return the place of a frame among the TPDOs of its node, 0 the most urgent."""
    first = GROUPS * (LEVELS + FINE_LEVELS - 1 - level) if is_fine else GROUPS * (LEVELS - 1 - level)
    return int(first + group)


@njit(cache=True, nogil=True)
def cob_id(node: int, level: int, group: int, is_fine: bool) -> int:
    """Return the identifier of a frame of the node with node-ID `node` + 1."""
    return FIRST_COB_ID + NODES * tpdo_index(level, group, is_fine) + node


def frame_of(identifier: int) -> tuple[int, int, int, bool]:
    """Return the node-ID, level, group and whether it is fine of an identifier from `FIRST_COB_ID` on."""
    index, node = divmod(identifier - FIRST_COB_ID, NODES)
    row, group = divmod(index, GROUPS)
    if row < LEVELS:
        return node + 1, LEVELS - 1 - row, group, False
    return node + 1, LEVELS + FINE_LEVELS - 1 - row, group, True


@njit(cache=True, nogil=True)
def coarse_code(value_n: float, is_mean: bool, law: Companding) -> int:
    """Return the byte of one sum in a coarse frame."""
    if is_mean:
        return min(MEAN_CODES, round(law.mean_slope * math.asinh(max(value_n, 0.0) / law.mean_knee_n)))
    code = round(law.slope * math.asinh(value_n / law.knee_n))
    return OTHER_CODES + 1 + max(-OTHER_CODES, min(OTHER_CODES, code))


@njit(cache=True, nogil=True)
def coarse_value(code: int, is_mean: bool, law: Companding) -> float:
    """Return what a byte of a coarse frame stands for, newtons."""
    if is_mean:
        return law.mean_knee_n * math.sinh(code / law.mean_slope)
    return law.knee_n * math.sinh((code - OTHER_CODES - 1) / law.slope)


@njit(cache=True, nogil=True)
def coarse_step(value_n: float, is_mean: bool, law: Companding) -> float:
    """Return the distance of neighbouring coarse values at a value, newtons: the derivative of the code's inverse."""
    if is_mean:
        return math.sqrt(value_n * value_n + law.mean_knee_n * law.mean_knee_n) / law.mean_slope
    return math.sqrt(value_n * value_n + law.knee_n * law.knee_n) / law.slope


@njit(cache=True, nogil=True)
def hold_coarse(  # noqa: PLR0917  compiled functions take no keywords
    payload: Bytes,
    first: int,
    is_held: bool,
    law: Companding,
    value_n: npt.NDArray[np.float64],
    coarse_n: npt.NDArray[np.float64],
) -> None:
    """Take the sums of a coarse frame, as every receiver does and the node that sent the frame.

    Parameters
    ----------
    payload : array of uint8, shape (GROUP_SUMS,)
    first : int
        Place of the frame's first sum in its block.
    is_held : bool
        Whether the group's values are known: a finer value that the code does not contradict then stays.
    value_n, coarse_n : arrays of float64, shape (BLOCK_SUMS,)
        Newest values of the block's sums and those of its newest coarse frames, newtons; written.
    """
    for place in range(GROUP_SUMS):
        is_mean, code = first + place == 0, int(payload[place])
        value = coarse_value(code, is_mean, law)
        if not is_held or value == 0 or coarse_code(value_n[first + place], is_mean, law) != code:
            value_n[first + place] = value
        coarse_n[first + place] = value


@njit(cache=True, nogil=True)
def check_of(payload: Bytes) -> int:
    """Return the CRC-8 of a coarse payload: the last byte of the fine frames that refine it."""
    crc = 0xFF
    for place in range(GROUP_SUMS):
        crc ^= int(payload[place])
        for _ in range(8):
            crc = ((crc << 1) ^ _CRC_8) & 0xFF if crc & 0x80 else (crc << 1) & 0xFF
    return crc


@njit(cache=True, nogil=True)
def fine_steps(value_n: float, law: Companding) -> int:
    """Return a value in fine steps."""
    return int(np.rint(value_n / law.fine_n))


@njit(cache=True, nogil=True)
def pack_fine(steps: npt.NDArray[np.int64], check: int, payload: Bytes) -> None:
    """Write a fine frame: the low seven bits of each of eight numbers, the first lowest, then the check."""
    packed = np.uint64(0)
    for place in range(GROUP_SUMS):
        packed |= np.uint64(steps[place] & (2 * FINE_REACH - 1)) << np.uint64(FINE_BITS * place)
    for byte in range(GROUP_SUMS - 1):
        payload[byte] = (packed >> np.uint64(8 * byte)) & np.uint64(0xFF)
    payload[GROUP_SUMS - 1] = check


@njit(cache=True, nogil=True)
def unpack_fine(
    payload: Bytes, coarse_n: npt.NDArray[np.float64], law: Companding, values_n: npt.NDArray[np.float64]
) -> None:
    """Write the values of a fine frame, newtons: of all numbers with the sent bits those nearest to `coarse_n`."""
    packed = np.uint64(0)
    for byte in range(GROUP_SUMS - 1):
        packed |= np.uint64(payload[byte]) << np.uint64(8 * byte)
    for place in range(GROUP_SUMS):
        near = fine_steps(coarse_n[place], law)
        sent = np.int64((packed >> np.uint64(FINE_BITS * place)) & np.uint64(2 * FINE_REACH - 1))
        away = (sent - near) & (2 * FINE_REACH - 1)
        if away >= FINE_REACH:
            away -= 2 * FINE_REACH
        values_n[place] = (near + away) * law.fine_n
