"""Data types and indices of the object dictionary, with the names of CiA 301, 7.4 and 7.5."""

from typing import Final

INTEGER8: Final = 0x02
INTEGER16: Final = 0x03
UNSIGNED8: Final = 0x05
UNSIGNED16: Final = 0x06
UNSIGNED32: Final = 0x07
REAL32: Final = 0x08
VISIBLE_STRING: Final = 0x09
UNSIGNED64: Final = 0x1B

SIGNED: Final = (INTEGER8, INTEGER16)
#: Width in bits; strings have none.
BITS: Final = {INTEGER8: 8, INTEGER16: 16, UNSIGNED8: 8, UNSIGNED16: 16, UNSIGNED32: 32, REAL32: 32, UNSIGNED64: 64}

OD_DEVICE_TYPE: Final = 0x1000
OD_ERROR_REGISTER: Final = 0x1001
OD_ERROR_FIELD: Final = 0x1003
OD_SYNC_COB_ID: Final = 0x1005
OD_CYCLE_PERIOD_US: Final = 0x1006
OD_WINDOW_US: Final = 0x1007
OD_DEVICE_NAME: Final = 0x1008
OD_HARDWARE_VERSION: Final = 0x1009
OD_SOFTWARE_VERSION: Final = 0x100A
OD_STORE: Final = 0x1010
OD_RESTORE: Final = 0x1011
OD_EMCY_COB_ID: Final = 0x1014
OD_EMCY_INHIBIT_100US: Final = 0x1015
OD_CONSUMER_HEARTBEAT: Final = 0x1016
OD_HEARTBEAT_MS: Final = 0x1017
OD_IDENTITY: Final = 0x1018
OD_SYNC_OVERFLOW: Final = 0x1019
OD_ERROR_BEHAVIOUR: Final = 0x1029
OD_SDO_SERVER: Final = 0x1200
OD_RPDO_COMMUNICATION: Final = 0x1400
OD_RPDO_MAPPING: Final = 0x1600
OD_TPDO_COMMUNICATION: Final = 0x1800
OD_TPDO_MAPPING: Final = 0x1A00
#: First object behind the communication profile area.
OD_MANUFACTURER: Final = 0x2000
OD_BLOCK: Final = 0x2000
OD_PHI_SEED: Final = 0x2001
OD_PHI_FINGERPRINT: Final = 0x2002
OD_ROWS: Final = 0x2003
OD_TAXELS: Final = 0x2004
OD_ENCODING: Final = 0x2005
OD_SIGNATURE: Final = 0x2006
OD_COMPANDING: Final = 0x2007
OD_STATE: Final = 0x2008
OD_GAIN: Final = 0x2010
OD_OFFSET: Final = 0x2011
OD_HEALTH: Final = 0x2020
OD_TEST_PATTERN: Final = 0x2021
OD_REFRESH: Final = 0x2030
OD_SENDING: Final = 0x2031
OD_COEFFICIENT_NOISE: Final = 0x2032
OD_TAXEL_NOISE: Final = 0x2033
OD_BUDGET: Final = 0x2034
OD_NODE_NOISE: Final = 0x2035
OD_TEMPERATURE: Final = 0x2036
OD_SUMS: Final = 0x2100
OD_COARSE: Final = 0x2110
OD_FINE: Final = 0x2111
#: Distance between the indices of an object for consecutive blocks of a node.
BLOCK_STRIDE: Final = 0x200

#: Signatures of 1010h and 1011h: the characters "save" and "load", least significant first.
SIGNATURE_SAVE: Final = 0x6576_6173
SIGNATURE_LOAD: Final = 0x6461_6F6C


def of_block(index: int, place: int) -> int:
    """Return the index of an object for the block at `place` of a node; `index` is that of the first block."""
    return index + place * BLOCK_STRIDE


def split_block(index: int) -> tuple[int, int]:
    """Return the place of the block that the object belongs to, and the object's index for the first block."""
    place, rest = divmod(index - OD_MANUFACTURER, BLOCK_STRIDE)
    return place, OD_MANUFACTURER + rest
