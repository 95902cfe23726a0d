"""What an SDO write may change, and when: the rules of the communication profile as one function per object.

Each raises the abort code the standard gives for the case (CiA 301, table 22).
"""

import math
from collections.abc import Callable
from typing import Any, Final

from canopen import SdoAbortedError

from dbc.contract import SYNC_COB_ID
from dbc.indices import (
    OD_EMCY_COB_ID,
    OD_ERROR_BEHAVIOUR,
    OD_ERROR_FIELD,
    OD_GAIN,
    OD_MANUFACTURER,
    OD_RESTORE,
    OD_STORE,
    OD_SYNC_COB_ID,
    OD_SYNC_OVERFLOW,
    OD_TEST_PATTERN,
    OD_TPDO_COMMUNICATION,
    OD_TPDO_MAPPING,
    SIGNATURE_LOAD,
    SIGNATURE_SAVE,
    split_block,
)
from nodes.objects import LocalNode

ABORT_NOT_MAPPABLE: Final = 0x0604_0041
ABORT_PDO_LENGTH: Final = 0x0604_0042
ABORT_VALUE: Final = 0x0609_0030
ABORT_STORE: Final = 0x0800_0020
ABORT_STATE: Final = 0x0800_0022

#: Bit 31 of a PDO's COB-ID: it does not exist (CiA 301, 7.5.2.37).
PDO_INVALID: Final = 0x8000_0000
FRAME_29_BIT: Final = 0x2000_0000
LAST_SYNCHRONOUS: Final = 240
TEST_PATTERNS: Final = 4

#: COB-IDs that no PDO may have (CiA 301, table 38).
RESTRICTED: Final = (
    range(0x001, 0x080),
    range(0x101, 0x181),
    range(0x581, 0x600),
    range(0x601, 0x680),
    range(0x6E0, 0x700),
    range(0x701, 0x800),
)


def check_write(node: LocalNode, index: int, subindex: int, value: float) -> None:
    """Raise `canopen.SdoAbortedError` when `value`, a whole number but for REAL32, must not be written now."""
    if OD_TPDO_COMMUNICATION <= index < OD_TPDO_COMMUNICATION + 0x200:
        _communication(node, index, subindex, int(value))
    elif OD_TPDO_MAPPING <= index < OD_TPDO_MAPPING + 0x200:
        _mapping(node, index, subindex, int(value))
    elif (rule := _VALUES.get(_first_block(index))) is not None and not rule(value):
        raise SdoAbortedError(ABORT_STORE if index in (OD_STORE, OD_RESTORE) else ABORT_VALUE)


def _first_block(index: int) -> int:
    return split_block(index)[1] if index >= OD_MANUFACTURER else index


#: Values an object accepts, where not all of its type.
_VALUES: Final[dict[int, Callable[[Any], bool]]] = {
    OD_ERROR_FIELD: lambda value: value == 0,
    OD_SYNC_COB_ID: lambda value: value == SYNC_COB_ID,  # a consumer, on the predefined identifier
    OD_STORE: lambda value: value == SIGNATURE_SAVE,
    OD_RESTORE: lambda value: value == SIGNATURE_LOAD,
    OD_EMCY_COB_ID: lambda value: value & 0x3FFF_F800 == 0 and value & 0x7FF != 0,
    OD_SYNC_OVERFLOW: lambda value: value == 0 or 2 <= value <= LAST_SYNCHRONOUS,
    OD_ERROR_BEHAVIOUR: lambda value: value <= 2,
    OD_GAIN: math.isfinite,
    OD_TEST_PATTERN: lambda value: value < TEST_PATTERNS,
}


def _communication(node: LocalNode, index: int, subindex: int, value: int) -> None:
    exists = not node.unsigned(index, 1) & PDO_INVALID
    if subindex == 1:
        can_id = value & 0x1FFF_FFFF
        wrong = value & FRAME_29_BIT or can_id in (0, 0x80) or any(can_id in block for block in RESTRICTED)
        if not value & PDO_INVALID and (wrong or can_id > 0x7FF):
            raise SdoAbortedError(ABORT_VALUE)
        if exists and not value & PDO_INVALID and can_id != node.unsigned(index, 1) & 0x1FFF_FFFF:
            raise SdoAbortedError(ABORT_STATE)
    elif subindex == 2:
        if LAST_SYNCHRONOUS < value < 254:  # reserved, or on remote request, which is not offered
            raise SdoAbortedError(ABORT_VALUE)
    elif subindex in (3, 6) and exists:
        raise SdoAbortedError(ABORT_STATE)


def _mapping(node: LocalNode, index: int, subindex: int, value: int) -> None:
    communication = index - OD_TPDO_MAPPING + OD_TPDO_COMMUNICATION
    if not node.unsigned(communication, 1) & PDO_INVALID:
        raise SdoAbortedError(ABORT_STATE)
    if subindex:
        if node.unsigned(index, 0):
            raise SdoAbortedError(ABORT_STATE)
        if value:
            _check_mappable(node, value)
        return
    if value > node.pdo_bytes:  # objects of one byte each
        raise SdoAbortedError(ABORT_PDO_LENGTH)
    entries = [node.unsigned(index, place) for place in range(1, value + 1)]
    for entry in entries:
        _check_mappable(node, entry)
    if sum(entry & 0xFF for entry in entries) > 8 * node.pdo_bytes:
        raise SdoAbortedError(ABORT_PDO_LENGTH)


def _check_mappable(node: LocalNode, entry: int) -> None:
    """Check one mapping entry: index, sub-index and length in bits of an object that PDOs may carry."""
    if node.mappable_bits(entry >> 16, entry >> 8 & 0xFF) != entry & 0xFF:
        raise SdoAbortedError(ABORT_NOT_MAPPABLE)
