"""CANopen's own tables (CiA 301): identifiers, NMT, SDO, abort codes, emergencies."""

from enum import IntEnum, IntFlag
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.messages import NmtState as NmtState  # noqa: PLC0414 - re-exported
from skin.foreign import BASE_ID_MAX, EXTENDED_ID_MAX

#: Predefined connection set (CiA 301, 7.3.5): COB-IDs, and bases to which a node adds its node-ID.
NMT_COB_ID: Final = 0x000
SYNC_COB_ID: Final = 0x080
TIME_COB_ID: Final = 0x100
EMCY_BASE: Final = 0x080
SDO_RESPONSE_BASE: Final = 0x580
SDO_REQUEST_BASE: Final = 0x600
HEARTBEAT_BASE: Final = 0x700
#: TPDO 1 to 4, then the identifiers of RPDO 1 to 4.
TPDO_BASES: Final = (0x180, 0x280, 0x380, 0x480, 0x200, 0x300, 0x400, 0x500)
HIGHEST_NODE_ID: Final = 127
#: Names of what each node has besides its PDOs, by base.
SERVICES: Final = {
    EMCY_BASE: "EMCY",
    SDO_RESPONSE_BASE: "SDO response",
    SDO_REQUEST_BASE: "SDO request",
    HEARTBEAT_BASE: "heartbeat",
}
#: LSS (CiA 305): requests of the master and responses of the slaves, always 8 bytes; the node-ID of a node without one.
LSS_REQUEST_COB_ID: Final = 0x7E5
LSS_RESPONSE_COB_ID: Final = 0x7E4
LSS_BYTES: Final = 8
NO_NODE_ID: Final = 0xFF
#: Standard bit timings by index, bit/s (CiA 305, table 1); index 5 is reserved.
LSS_BIT_RATES_HZ: Final = (1_000_000, 800_000, 500_000, 250_000, 125_000, 0, 50_000, 20_000, 10_000)


def identifier_text(cob_id: int, *, is_extended: bool = False) -> str:
    """Return an identifier in three or eight hexadecimal digits, as in logs."""
    return f"{cob_id:0{8 if is_extended else 3}X}h"


def is_of_node(can_id: npt.NDArray[np.uint32], base: int) -> npt.NDArray[np.bool_]:
    """Tell which identifiers are `base` + a node-ID."""
    return (can_id > base) & (can_id <= base + HIGHEST_NODE_ID)


#: COB-IDs that no PDO, EMCY or SYNC may be moved to (CiA 301, table 38).
RESTRICTED_COB_IDS: Final = (
    range(0x001, 0x080),
    range(0x101, 0x181),
    range(0x581, 0x600),
    range(0x601, 0x680),
    range(0x6E0, 0x700),
    range(0x701, 0x800),
)
#: Bit 31 of a COB-ID object: the PDO or EMCY does not exist (CiA 301, 7.5.2.17 and 7.5.2.37).
COB_ID_INVALID: Final = 0x8000_0000
#: Bit 30 of a PDO's COB-ID: remote frames are not allowed.
COB_ID_NO_RTR: Final = 0x4000_0000
#: Bit 29 of a COB-ID object: 29-bit identifier.
COB_ID_EXTENDED: Final = 0x2000_0000
#: The 11-bit and the 29-bit identifier within a COB-ID object.
BASE_ID_MASK: Final = BASE_ID_MAX
EXTENDED_ID_MASK: Final = EXTENDED_ID_MAX

#: Highest cyclic synchronous transmission type, and highest value of 1019h (CiA 301, 7.5.2.38 and 7.5.2.22).
LAST_SYNCHRONOUS: Final = 240
#: Lowest event-driven transmission type (manufacturer-specific); 255 is specific to the device profile.
EVENT_MANUFACTURER: Final = 254

#: Lengths of the messages (CiA 301, 7.2).
NMT_BYTES: Final = 2
SDO_BYTES: Final = 8
EMCY_BYTES: Final = 8
HEARTBEAT_BYTES: Final = 1

#: First bytes of the answers to a block download (CiA 301, 7.2.4.3.9 to 7.2.4.3.11).
SDO_BLOCKS_BEGUN: Final = 0xA0
SDO_BLOCK_TAKEN: Final = 0xA2
SDO_BLOCKS_TAKEN: Final = 0xA1


class NmtCommand(IntEnum):
    """NMT command specifiers (CiA 301, 7.2.8.3.1)."""

    START = 1
    STOP = 2
    ENTER_PRE_OPERATIONAL = 128
    RESET_NODE = 129
    RESET_COMMUNICATION = 130


#: The state that a command leads to; the two resets lead through initialisation.
COMMANDED: Final = {
    NmtCommand.START: NmtState.OPERATIONAL,
    NmtCommand.STOP: NmtState.STOPPED,
    NmtCommand.ENTER_PRE_OPERATIONAL: NmtState.PRE_OPERATIONAL,
}


def state_text(state: int) -> str:
    """Return an NMT state (CiA 301, 7.2.8.3.2.2) in words."""
    try:
        return NmtState(state).name.lower().replace("_", "-")
    except ValueError:
        return f"state {state}"


class Abort(IntEnum):
    """SDO abort codes (CiA 301, table 22)."""

    TOGGLE = 0x0503_0000
    TIMEOUT = 0x0504_0000
    COMMAND = 0x0504_0001
    CRC = 0x0504_0004
    MEMORY = 0x0504_0005
    WRITE_ONLY = 0x0601_0001
    READ_ONLY = 0x0601_0002
    NO_OBJECT = 0x0602_0000
    NOT_MAPPABLE = 0x0604_0041
    PDO_LENGTH = 0x0604_0042
    INCOMPATIBLE = 0x0604_0043
    HARDWARE = 0x0606_0000
    LENGTH = 0x0607_0010
    TOO_LONG = 0x0607_0012
    NO_SUBINDEX = 0x0609_0011
    VALUE = 0x0609_0030
    NOT_STORED = 0x0800_0020
    STATE = 0x0800_0022
    NO_DATA = 0x0800_0024


#: Lower abort codes concern the transfer (toggle bit, time-out, command), codes from here on the object.
FIRST_ABORT_OF_THE_OBJECT: Final = 0x0600_0000


class Lss(IntEnum):
    """Command specifiers of LSS (CiA 305). An address is vendor-ID, product code, revision, serial number (1018h)."""

    SWITCH_GLOBAL = 0x04
    NODE_ID = 0x11
    BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE = 0x17
    #: Four requests, one for each number of the address.
    SWITCH_SELECTIVE = 0x40
    SELECTED = 0x44
    #: Six requests: vendor-ID, product code, revision from and to, serial number from and to.
    IDENTIFY = 0x46
    IDENTIFY_UNNUMBERED = 0x4C
    IDENTIFIED = 0x4F
    IDENTIFIED_UNNUMBERED = 0x50
    FASTSCAN = 0x51
    #: Four requests, one for each number of the address.
    INQUIRE_ADDRESS = 0x5A
    INQUIRE_NODE_ID = 0x5E


class LssError(IntEnum):
    """Error codes of LSS responses (CiA 305); a value out of range is not supported."""

    NONE = 0
    NOT_SUPPORTED = 1
    STORAGE = 2


#: Index of a bit timing that is not known.
NO_BIT_TIMING: Final = 0xFF
#: Bit check of the fastscan request that every node without node-ID answers.
FASTSCAN_ALL: Final = 0x80


class Emergency(IntEnum):
    """Error codes that a skin node can report (CiA 301, table 26; codes from FF00h are manufacturer-specific)."""

    NONE = 0x0000
    HEARTBEAT_LOST = 0x8130
    SYNC_LENGTH = 0x8240
    WINDOW_MISSED = 0xFF10


class ErrorRegister(IntFlag):
    """Bits of the error register (CiA 301, 7.5.2.2)."""

    GENERIC = 0x01
    COMMUNICATION = 0x10
    MANUFACTURER = 0x80
