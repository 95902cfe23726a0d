"""Checks of SDO writes: the rules of the communication profile, one function per object.

Each function raises the abort code of the standard (CiA 301, table 22).
"""

import math
import struct
from collections.abc import Callable
from typing import Any, Final

from canopen import SdoAbortedError

from dbc import indices as od
from dbc.board_sums import PATTERN_FULL
from dbc.canopen import (
    BASE_ID_MASK,
    COB_ID_EXTENDED,
    COB_ID_INVALID,
    EVENT_MANUFACTURER,
    EXTENDED_ID_MASK,
    LAST_SYNCHRONOUS,
    RESTRICTED_COB_IDS,
    SYNC_COB_ID,
    Abort,
)
from dbc.dictionary import HEARTBEATS_WATCHED
from dbc.patch_filter import GIVEN_NOISE_N
from nodes.heartbeat import watched_node
from nodes.objects import LocalNode
from skin.sync_counter import SYNC_OVERFLOW


def check_write(node: LocalNode, index: int, subindex: int, value: float) -> None:
    """Raise `canopen.SdoAbortedError` if `value` must not be written now; only REAL32 values may be fractions."""
    if od.TPDO_COMMUNICATION <= index < od.TPDO_MAPPING:
        _communication(node, index, subindex, int(value))
    elif od.TPDO_MAPPING <= index < od.TPDO_END:
        _mapping(node, index, subindex, int(value))
    elif index == od.EMCY_COB_ID:
        _emcy(node, int(value))
    elif index == od.CONSUMER_HEARTBEAT:
        _consumer_heartbeat(node, subindex, int(value))
    elif (rule := _VALUES.get(od.split_block(index)[1])) is not None and not rule(value):
        raise SdoAbortedError(Abort.NOT_STORED if index in (od.STORE, od.RESTORE) else Abort.VALUE)
    elif index == od.SENDING and subindex == 2 and not 1 <= value <= SYNC_OVERFLOW:
        raise SdoAbortedError(Abort.VALUE)
    elif index == od.SYNC_OVERFLOW and node.unsigned(od.CYCLE_PERIOD_US):
        raise SdoAbortedError(Abort.STATE)  # CiA 301, 7.5.2.22


def is_storable(index: int, data_type: int | None, data: bytes) -> bool:
    """Tell whether a stored value fits an object that can be written; test patterns and refreshes cannot be stored."""
    if index in (od.STORE, od.RESTORE, od.ERROR_FIELD) or od.split_block(index)[1] in _ORDERS:
        return False
    if len(data) * 8 != od.BITS.get(data_type or 0):
        return False
    rule = _VALUES.get(od.split_block(index)[1])
    return rule is None or rule(number(data_type, data))


def number(data_type: int | None, data: bytes) -> float:
    """Return the value of an object's bytes; whole numbers as unsigned."""
    return float(struct.unpack("<f", data)[0]) if data_type == od.REAL32 else int.from_bytes(data, "little")


def _is_noise(value: float) -> bool:
    return value == 0 or GIVEN_NOISE_N[0] <= value <= GIVEN_NOISE_N[1]


#: Objects of the manufacturer whose value is an order to the running node: they are not restored.
_ORDERS: Final = (od.TEST_PATTERN, od.REFRESH)

#: Accepted values of the objects that do not accept every value of their type.
_VALUES: Final[dict[int, Callable[[Any], bool]]] = {
    od.ERROR_FIELD: lambda value: value == 0,
    od.SYNC_COB_ID: lambda value: value == SYNC_COB_ID,  # a consumer, on the predefined identifier
    od.STORE: lambda value: value == od.SIGNATURE_SAVE,
    od.RESTORE: lambda value: value == od.SIGNATURE_LOAD,
    od.SYNC_OVERFLOW: lambda value: value == 0 or 2 <= value <= LAST_SYNCHRONOUS,
    od.ERROR_BEHAVIOUR: lambda value: value <= 2,
    od.GAIN: math.isfinite,
    od.TEST_PATTERN: lambda value: value <= PATTERN_FULL,
    od.REFRESH: lambda value: value <= 1,
    od.SENDING: lambda value: 0 <= value < math.inf,
    od.COEFFICIENT_NOISE: _is_noise,
    od.TAXEL_NOISE: _is_noise,
}


def _communication(node: LocalNode, index: int, subindex: int, value: int) -> None:
    exists = not node.unsigned(index, 1) & COB_ID_INVALID
    if subindex == 1:
        _cob_id(node.unsigned(index, 1), value)
    elif subindex == 2:
        if LAST_SYNCHRONOUS < value < EVENT_MANUFACTURER:  # reserved, or on remote request, which is not offered
            raise SdoAbortedError(Abort.VALUE)
    elif subindex in (3, 6) and exists:
        raise SdoAbortedError(Abort.STATE)


def _cob_id(present: int, value: int) -> None:
    """Check the COB-ID of a PDO or EMCY: it must be free, and must not change while the message exists."""
    can_id = value & EXTENDED_ID_MASK
    is_free = 0 < can_id <= BASE_ID_MASK and can_id != SYNC_COB_ID and not value & COB_ID_EXTENDED
    if not value & COB_ID_INVALID and (not is_free or any(can_id in block for block in RESTRICTED_COB_IDS)):
        raise SdoAbortedError(Abort.VALUE)
    if not (present | value) & COB_ID_INVALID and can_id != present & EXTENDED_ID_MASK:
        raise SdoAbortedError(Abort.STATE)


def _emcy(node: LocalNode, value: int) -> None:
    """Check 1014h (CiA 301, 7.5.2.17)."""
    if value & COB_ID_EXTENDED:
        raise SdoAbortedError(Abort.VALUE)
    _cob_id(node.unsigned(od.EMCY_COB_ID), value)


def _consumer_heartbeat(node: LocalNode, subindex: int, value: int) -> None:
    """Check an entry of 1016h: no node-ID is watched twice (CiA 301, 7.5.2.18)."""
    others = [
        node.unsigned(od.CONSUMER_HEARTBEAT, each) for each in range(1, HEARTBEATS_WATCHED + 1) if each != subindex
    ]
    if watched_node(value) and watched_node(value) in map(watched_node, others):
        raise SdoAbortedError(Abort.INCOMPATIBLE)


def _mapping(node: LocalNode, index: int, subindex: int, value: int) -> None:
    communication = index - od.TPDO_MAPPING + od.TPDO_COMMUNICATION
    if not node.unsigned(communication, 1) & COB_ID_INVALID:
        raise SdoAbortedError(Abort.STATE)
    if subindex:
        if node.unsigned(index, 0):
            raise SdoAbortedError(Abort.STATE)
        if value:
            _check_mappable(node, value)
        return
    if node.variable(index, value) is None:
        raise SdoAbortedError(Abort.PDO_LENGTH)
    entries = [node.unsigned(index, place) for place in range(1, value + 1)]
    for entry in entries:
        _check_mappable(node, entry)
    if sum(entry & 0xFF for entry in entries) > 8 * node.pdo_bytes:
        raise SdoAbortedError(Abort.PDO_LENGTH)


def _check_mappable(node: LocalNode, entry: int) -> None:
    """Check one mapping entry: index, sub-index and length in bits of an object that PDOs may carry."""
    if node.mappable_bits(entry >> 16, entry >> 8 & 0xFF) != entry & 0xFF:
        raise SdoAbortedError(Abort.NOT_MAPPABLE)
