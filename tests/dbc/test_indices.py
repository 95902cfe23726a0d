"""Indices and data types of the object dictionary, as CiA 301 and docs/bus.md have them."""

from typing import Final

import pytest

from dbc import indices as od

#: CiA 301, 7.4.7.
DATA_TYPES: Final = {
    "INTEGER8": 0x0002,
    "INTEGER16": 0x0003,
    "UNSIGNED8": 0x0005,
    "UNSIGNED16": 0x0006,
    "UNSIGNED32": 0x0007,
    "REAL32": 0x0008,
    "VISIBLE_STRING": 0x0009,
    "DOMAIN": 0x000F,
    "UNSIGNED56": 0x001A,
}
#: CiA 301, 7.5.2.
COMMUNICATION: Final = {
    "DEVICE_TYPE": 0x1000,
    "ERROR_REGISTER": 0x1001,
    "ERROR_FIELD": 0x1003,
    "SYNC_COB_ID": 0x1005,
    "CYCLE_PERIOD_US": 0x1006,
    "WINDOW_US": 0x1007,
    "DEVICE_NAME": 0x1008,
    "HARDWARE_VERSION": 0x1009,
    "SOFTWARE_VERSION": 0x100A,
    "STORE": 0x1010,
    "RESTORE": 0x1011,
    "EMCY_COB_ID": 0x1014,
    "EMCY_INHIBIT_100US": 0x1015,
    "CONSUMER_HEARTBEAT": 0x1016,
    "HEARTBEAT_MS": 0x1017,
    "IDENTITY": 0x1018,
    "SYNC_OVERFLOW": 0x1019,
    "ERROR_BEHAVIOUR": 0x1029,
    "SDO_SERVER": 0x1200,
    "TPDO_COMMUNICATION": 0x1800,
    "TPDO_MAPPING": 0x1A00,
    "TPDO_END": 0x1C00,
    "PROGRAM_DATA": 0x1F50,  # CiA 302-3
    "PROGRAM_CONTROL": 0x1F51,
    "PROGRAM_ID": 0x1F56,
    "FLASH_STATUS": 0x1F57,
}
#: docs/bus.md, "Objects of a skin node", and docs/steps.md.
OF_THE_SKIN: Final = {
    "MANUFACTURER": 0x2000,
    "BLOCK": 0x2000,
    "PHI_SEED": 0x2001,
    "PHI_FINGERPRINT": 0x2002,
    "ROWS": 0x2003,
    "TAXELS": 0x2004,
    "ENCODING": 0x2005,
    "SIGNATURE": 0x2006,
    "UNIT": 0x2007,
    "CALIBRATION_SIGNATURE": 0x2009,
    "GAIN": 0x2010,
    "OFFSET": 0x2011,
    "COUNTS": 0x2012,
    "HEALTH": 0x2020,
    "TEST_PATTERN": 0x2021,
    "SYNC_COUNTER": 0x2022,
    "REFRESH": 0x2030,
    "SENDING": 0x2031,
    "COEFFICIENT_NOISE": 0x2032,
    "TAXEL_NOISE": 0x2033,
    "NODE_NOISE": 0x2035,
    "TEMPERATURE": 0x2036,
    "SUMS": 0x2100,
    "WORDS": 0x2110,
}


def test_indices_are_those_of_the_standard_and_the_documentation() -> None:
    documented = COMMUNICATION | OF_THE_SKIN
    whole = {name: number for name, number in vars(od).items() if isinstance(number, int)}
    assert {name: number for name, number in whole.items() if 0x1000 <= number < 0x3000} == documented


def test_data_types_are_those_of_the_standard() -> None:
    assert {name: getattr(od, name) for name in DATA_TYPES} == DATA_TYPES
    assert set(od.SIGNED) == {2, 3}
    assert od.BITS == {2: 8, 3: 16, 5: 8, 6: 16, 7: 32, 8: 32, 0x1A: 56}


def test_signatures_are_words_with_the_first_letter_lowest() -> None:
    assert od.SIGNATURE_SAVE.to_bytes(4, "little") == b"save"
    assert od.SIGNATURE_LOAD.to_bytes(4, "little") == b"load"


@pytest.mark.parametrize(
    ("first", "place", "index"),
    [(0x2003, 0, 0x2003), (0x2003, 1, 0x2203), (0x2100, 3, 0x2700), (0x2000, 7, 0x2E00), (0x21FF, 7, 0x2FFF)],
)
def test_objects_of_further_blocks_are_200h_apart(first: int, place: int, index: int) -> None:
    assert od.of_block(first, place) == index
    assert od.split_block(index) == (place, first)


@pytest.mark.parametrize("index", [0x1010, 0x1810, 0x1A10, 0x1900, 0x1FFF])
def test_objects_of_the_communication_profile_belong_to_no_block(index: int) -> None:
    """1A10h, a mapping, is not the gains of a block before the first."""
    assert od.split_block(index) == (0, index)
