"""Data types and indices of the object dictionary, with the names of CiA 301, 7.4 and 7.5."""

from typing import Final

BOOLEAN: Final = 0x01
INTEGER8: Final = 0x02
INTEGER16: Final = 0x03
UNSIGNED8: Final = 0x05
UNSIGNED16: Final = 0x06
UNSIGNED32: Final = 0x07
REAL32: Final = 0x08
VISIBLE_STRING: Final = 0x09
UNICODE_STRING: Final = 0x0B
DOMAIN: Final = 0x0F
UNSIGNED56: Final = 0x1A

#: Width in bits, of whole numbers with and without sign.
SIGNED: Final = {INTEGER8: 8, INTEGER16: 16, 0x04: 32, 0x10: 24, 0x12: 40, 0x13: 48, 0x14: 56, 0x15: 64}
UNSIGNED: Final = {
    BOOLEAN: 1,
    UNSIGNED8: 8,
    UNSIGNED16: 16,
    UNSIGNED32: 32,
    0x16: 24,
    0x18: 40,
    0x19: 48,
    UNSIGNED56: 56,
    0x1B: 64,
}
#: Format for `struct`, of fractions: REAL32 and REAL64.
REALS: Final = {REAL32: "<f", 0x11: "<d"}
#: Width in bits of all numbers; strings have none.
BITS: Final = {**SIGNED, **UNSIGNED, REAL32: 32, 0x11: 64}

DEVICE_TYPE: Final = 0x1000
ERROR_REGISTER: Final = 0x1001
ERROR_FIELD: Final = 0x1003
SYNC_COB_ID: Final = 0x1005
CYCLE_PERIOD_US: Final = 0x1006
WINDOW_US: Final = 0x1007
DEVICE_NAME: Final = 0x1008
HARDWARE_VERSION: Final = 0x1009
SOFTWARE_VERSION: Final = 0x100A
STORE: Final = 0x1010
RESTORE: Final = 0x1011
EMCY_COB_ID: Final = 0x1014
EMCY_INHIBIT_100US: Final = 0x1015
CONSUMER_HEARTBEAT: Final = 0x1016
HEARTBEAT_MS: Final = 0x1017
IDENTITY: Final = 0x1018
SYNC_OVERFLOW: Final = 0x1019
ERROR_BEHAVIOUR: Final = 0x1029
SDO_SERVER: Final = 0x1200
TPDO_COMMUNICATION: Final = 0x1800
TPDO_MAPPING: Final = 0x1A00
#: First object behind those of TPDOs.
TPDO_END: Final = 0x1C00
#: Program download (CiA 302-3): data, control, identification, and status of the flash memory.
PROGRAM_DATA: Final = 0x1F50
PROGRAM_CONTROL: Final = 0x1F51
PROGRAM_ID: Final = 0x1F56
FLASH_STATUS: Final = 0x1F57
#: First object behind the communication profile area.
MANUFACTURER: Final = 0x2000
BLOCK: Final = 0x2000
PHI_SEED: Final = 0x2001
PHI_FINGERPRINT: Final = 0x2002
ROWS: Final = 0x2003
TAXELS: Final = 0x2004
ENCODING: Final = 0x2005
SIGNATURE: Final = 0x2006
UNIT: Final = 0x2007
CALIBRATION_SIGNATURE: Final = 0x2009
GAIN: Final = 0x2010
OFFSET: Final = 0x2011
COUNTS: Final = 0x2012
HEALTH: Final = 0x2020
TEST_PATTERN: Final = 0x2021
SYNC_COUNTER: Final = 0x2022
REFRESH: Final = 0x2030
SENDING: Final = 0x2031
COEFFICIENT_NOISE: Final = 0x2032
TAXEL_NOISE: Final = 0x2033
NODE_NOISE: Final = 0x2035
TEMPERATURE: Final = 0x2036
SUMS: Final = 0x2100
WORDS: Final = 0x2110
#: Distance between the indices of an object for consecutive blocks of a node.
BLOCK_STRIDE: Final = 0x200

#: Signatures of 1010h and 1011h: the characters "save" and "load", least significant first.
SIGNATURE_SAVE: Final = 0x6576_6173
SIGNATURE_LOAD: Final = 0x6461_6F6C


def is_program_download(index: int) -> bool:
    """Tell whether an object is one of program download; a board needs none of them."""
    return PROGRAM_DATA <= index <= FLASH_STATUS


def of_block(index: int, place: int) -> int:
    """Return the index of an object for the block at `place` of a node; `index` is that of the first block."""
    return index + place * BLOCK_STRIDE


def split_block(index: int) -> tuple[int, int]:
    """Return the place of the block that the object belongs to, and the object's index for the first block.

    Objects below 2000h belong to no block: place 0, and their own index.
    """
    if index < MANUFACTURER:
        return 0, index
    place, rest = divmod(index - MANUFACTURER, BLOCK_STRIDE)
    return place, MANUFACTURER + rest
