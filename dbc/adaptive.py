"""How adaptive nodes put sums into frames: coarse and fine codes, and identifiers that carry urgency.

A *coarse* frame carries the eight sums of a group, each as a companded byte that needs no earlier frame. A *fine* frame
refines the values of the newest coarse frame of its group: seven bits of each sum, and a check that tells which coarse
frame it belongs to.

A CAN FD frame carries up to four groups, and is called by the first of them: its *parts* are the payloads of their
coarse frames, and in a fine frame the payloads of the fine frames that refine these.
"""

import math
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shell.compiled import njit
from skin.sending import IDENTIFIERS, columns_of, groups_of_frame
from skin.walsh import GROUP_ROWS

#: Sums of a group, one byte each in a coarse frame.
GROUP_SUMS: Final = GROUP_ROWS
#: Urgency levels of coarse frames, 0 the lowest, and of fine frames.
LEVELS: Final = 6
FINE_LEVELS: Final = 2
#: Kinds and levels of frames: a node has this number of TPDOs for each frame that it divides its groups into.
KINDS: Final = LEVELS + FINE_LEVELS
#: COB-ID of the first TPDO of node 1; those of all nodes end at 580h, below the SDO answers.
FIRST_COB_ID: Final = 0x181
#: No TPDO starts in this time after a SYNC, so that SDO answers and heartbeats find room on a full bus.
PAUSE_MS: Final = 2
#: Time from a frame's expiry until frame and echo are given up for lost.
LOST_NS: Final = 500_000_000
#: A node can save up its budget of this time, and at least that of this number of frames for each group.
SAVING_S: Final = 0.25
SAVED_FRAMES: Final = 2
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
CRC_8: Final = 0x2F
#: In place of a check: no coarse payload of the group is held.
NO_CHECK: Final = -1

Bytes = npt.NDArray[np.uint8]


class SendingRule(NamedTuple):
    """When sums are sent; times in samples of 1 ms.

    A group is news when the squared difference between its sums and those that were sent exceeds the threshold
    ``8 · B · (noise_ratio · σ)² + variance_ratio · Σ Var``, B the places of the node's taxels, σ its noise. Differences
    below `rounding` coarse steps do not count.

    Attributes
    ----------
    noise_ratio, variance_ratio, rounding : float
    level_ratio : float
        A level of urgency stands for this many doublings of difference over threshold.
    doubling : float
        A wait of this time counts as twice the difference.
    inhibit : int
        Least time between two frames of a group (the TPDOs' inhibit time).
    fine_ratio : float
        Part of the noise's threshold that a difference of details has to exceed.
    fine_wait : int
        Least time from any frame of a group to its next frame of details.
    refresh, refresh_max : int
        A group is sent again after this time, which doubles with each repetition.
    overdue : int
        A refresh goes up one level after this wait.
    zero_refreshes : int
        Number of times that a group at zero is sent again.
    patience : int
        News has the highest level after this wait, and no other news has.
    """

    noise_ratio: float = 0.15
    variance_ratio: float = 2.0
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


def companding(force_max_n: float, step_n: float, taxels: int) -> Companding:
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


#: How many groups a frame carries, for compiled code.
carried: Final = njit(cache=True, nogil=True)(groups_of_frame)


@njit(cache=True, nogil=True)
def tpdo_index(level: int, group: int, is_fine: bool, groups: int) -> int:
    """Return the place of a frame among the TPDOs of a node with `groups`, 0 the most urgent.

    On CAN FD the places of groups that are not the first of their frame stay empty.
    """
    return int(groups * (KINDS - 1 - level if is_fine else LEVELS - 1 - level) + group)


def column_of(node_id: int, groups: int, *, is_fd: bool) -> int:
    """Return the place of a node among the identifiers of a kind, urgency and group, from 0."""
    return (node_id - 1) % columns_of(groups, is_fd)


def cob_id(column: int, level: int, group: int, is_fine: bool, groups: int) -> int:
    """Return the identifier of a frame of the node at `column` (`column_of`) with `groups` groups."""
    kind = tpdo_index(level, 0, is_fine, 1)
    return FIRST_COB_ID + IDENTIFIERS * kind + IDENTIFIERS // groups * group + column


@njit(cache=True, nogil=True)
def decode_cob_id(identifier: int, groups: int, is_fd: bool) -> tuple[int, int, int]:
    """Return kind and level as a number (from `LEVELS` on: fine), first group and column of an identifier.

    The number is -1 for identifiers that are no sums. The column (`column_of`) is that of a node with `groups` groups.
    """
    kind, column = (identifier - FIRST_COB_ID) // IDENTIFIERS, (identifier - FIRST_COB_ID) % IDENTIFIERS
    if identifier < FIRST_COB_ID or kind >= KINDS:
        return -1, 0, 0
    together = carried(groups, is_fd)
    nodes = IDENTIFIERS // groups * together
    return kind, column // nodes * together, column % nodes


def frame_of(identifier: int, *, groups: int, is_fd: bool = False) -> tuple[int, int, int, bool]:
    """Return column, level, first group and whether it is fine of an identifier of sums."""
    kind, group, column = decode_cob_id(identifier, groups, is_fd)
    if kind < LEVELS:
        return column, LEVELS - 1 - kind, group, False
    return column, KINDS - 1 - kind, group, True


@njit(cache=True, nogil=True)
def parts_of(is_fine: bool, is_fd: bool, groups: int) -> int:
    """Return how many payloads of `GROUP_SUMS` bytes a frame of a node with `groups` groups holds."""
    return carried(groups, is_fd) * (2 if is_fine and is_fd else 1)


@njit(cache=True, nogil=True)
def payload_bytes(is_fine: bool, is_fd: bool, groups: int) -> int:
    """Return the payload of a frame in bytes: 8 for each part."""
    return GROUP_SUMS * parts_of(is_fine, is_fd, groups)


@njit(cache=True, nogil=True)
def part_of(part: int, group: int, is_fine: bool, is_fd: bool, groups: int) -> tuple[int, bool]:
    """Return the group of a part of a frame, and whether the part is fine; `group` and `is_fine` are the frame's."""
    if is_fd:
        together = carried(groups, is_fd)
        return group + part % together, part >= together
    return group, is_fine


@njit(cache=True, nogil=True)
def coarse_code(value_n: float, is_mean: bool, law: Companding) -> int:
    """Return the byte of one sum in a coarse frame."""
    if is_mean:
        return min(MEAN_CODES, round(law.mean_slope * math.asinh(max(value_n, 0.0) / law.mean_knee_n)))
    code = round(law.slope * math.asinh(value_n / law.knee_n))
    return OTHER_CODES + 1 + max(-OTHER_CODES, min(OTHER_CODES, code))


@njit(cache=True, nogil=True)
def has_same_code(one_n: float, other_n: float, is_mean: bool, law: Companding) -> bool:
    """Tell whether two sums have the same byte in a coarse frame."""
    slope, knee_n, most = law.slope, law.knee_n, OTHER_CODES
    if is_mean:
        slope, knee_n, most = law.mean_slope, law.mean_knee_n, MEAN_CODES
        one_n, other_n = max(one_n, 0.0), max(other_n, 0.0)
    # The code is least steep at the larger sum. If the sums are more than a code apart even there, no asinh is needed,
    # unless both may have the last code: asinh(x) <= x, so the smaller sum below has not.
    far_n, near_n = max(abs(one_n), abs(other_n)), min(abs(one_n), abs(other_n))
    apart_n = slope * (one_n - other_n)
    if slope * near_n < knee_n * (most - 1) and apart_n * apart_n > far_n * far_n + knee_n * knee_n:
        return False
    return coarse_code(one_n, is_mean, law) == coarse_code(other_n, is_mean, law)


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
    """Take the sums of a coarse payload.

    Parameters
    ----------
    payload : array of uint8, shape (GROUP_SUMS,)
    first : int
        Place of the frame's first sum in its block.
    is_held : bool
        Whether the group's values are known: a finer value that the code does not contradict then stays.
    value_n, coarse_n : arrays of float64, shape (sums,)
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
            crc = ((crc << 1) ^ CRC_8) & 0xFF if crc & 0x80 else (crc << 1) & 0xFF
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


@njit(cache=True, nogil=True)
def refines(payload: Bytes, group: int, is_fd: bool, check: npt.NDArray[np.int64]) -> bool:
    """Tell whether the fine parts of a fine frame refine what is held, on CAN FD the coarse parts of the same frame."""
    if not is_fd:
        return bool(check[group] == int(payload[GROUP_SUMS - 1]))
    together = carried(check.size, is_fd)
    for part in range(together):
        coarse = payload[GROUP_SUMS * part : GROUP_SUMS * (part + 1)]
        if check_of(coarse) != int(payload[GROUP_SUMS * (together + part + 1) - 1]):
            return False
    return True


@njit(cache=True, nogil=True)
def hold(  # noqa: PLR0917  compiled functions take no keywords
    payload: Bytes,
    group: int,
    is_fine: bool,
    is_fd: bool,
    law: Companding,
    value_n: npt.NDArray[np.float64],
    coarse_n: npt.NDArray[np.float64],
    check: npt.NDArray[np.int64],
) -> bool:
    """Take the sums of a frame, as every receiver does and the node that sent the frame.

    A fine part counts for one coarse payload only: the newest of its group, on CAN FD that of the same frame.

    Parameters
    ----------
    payload : array of uint8
        At least `payload_bytes` long.
    value_n, coarse_n : arrays of float64, shape (sums,)
        See `hold_coarse`; written.
    check : array of int64, shape (groups,)
        Checks of the newest coarse payloads, `NO_CHECK` before the first; written.

    Returns
    -------
    bool
        False, and nothing is taken, if a fine part refines another coarse payload.
    """
    if is_fine and not refines(payload, group, is_fd, check):
        return False
    for part in range(parts_of(is_fine, is_fd, check.size)):
        each, is_fine_part = part_of(part, group, is_fine, is_fd, check.size)
        mine, sums = (
            payload[GROUP_SUMS * part : GROUP_SUMS * (part + 1)],
            slice(GROUP_SUMS * each, GROUP_SUMS * (each + 1)),
        )
        if is_fine_part:
            unpack_fine(mine, coarse_n[sums], law, value_n[sums])
        else:
            hold_coarse(mine, GROUP_SUMS * each, check[each] != NO_CHECK, law, value_n, coarse_n)
            check[each] = check_of(mine)
    return True
