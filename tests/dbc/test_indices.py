"""Indices and data types of the object dictionary, as CiA 301 and docs/bus.md have them."""

from typing import Final

import pytest

import dbc.indices
from dbc.indices import SIGNATURE_LOAD, SIGNATURE_SAVE, of_block, split_block

#: CiA 301, 7.4.7.
DATA_TYPES: Final = {
    "INTEGER8": 0x0002,
    "INTEGER16": 0x0003,
    "UNSIGNED8": 0x0005,
    "UNSIGNED16": 0x0006,
    "UNSIGNED32": 0x0007,
    "REAL32": 0x0008,
    "VISIBLE_STRING": 0x0009,
    "UNSIGNED64": 0x001B,
}
#: CiA 301, 7.5.2.
COMMUNICATION: Final = {
    "OD_DEVICE_TYPE": 0x1000,
    "OD_ERROR_REGISTER": 0x1001,
    "OD_ERROR_FIELD": 0x1003,
    "OD_SYNC_COB_ID": 0x1005,
    "OD_CYCLE_PERIOD_US": 0x1006,
    "OD_WINDOW_US": 0x1007,
    "OD_DEVICE_NAME": 0x1008,
    "OD_HARDWARE_VERSION": 0x1009,
    "OD_SOFTWARE_VERSION": 0x100A,
    "OD_STORE": 0x1010,
    "OD_RESTORE": 0x1011,
    "OD_EMCY_COB_ID": 0x1014,
    "OD_EMCY_INHIBIT_100US": 0x1015,
    "OD_CONSUMER_HEARTBEAT": 0x1016,
    "OD_HEARTBEAT_MS": 0x1017,
    "OD_IDENTITY": 0x1018,
    "OD_SYNC_OVERFLOW": 0x1019,
    "OD_ERROR_BEHAVIOUR": 0x1029,
    "OD_SDO_SERVER": 0x1200,
    "OD_RPDO_COMMUNICATION": 0x1400,
    "OD_RPDO_MAPPING": 0x1600,
    "OD_TPDO_COMMUNICATION": 0x1800,
    "OD_TPDO_MAPPING": 0x1A00,
}
#: docs/bus.md, "Objects of a skin node", and docs/adaptive.md.
OF_THE_SKIN: Final = {
    "OD_MANUFACTURER": 0x2000,
    "OD_BLOCK": 0x2000,
    "OD_PHI_SEED": 0x2001,
    "OD_PHI_FINGERPRINT": 0x2002,
    "OD_ROWS": 0x2003,
    "OD_TAXELS": 0x2004,
    "OD_ENCODING": 0x2005,
    "OD_SIGNATURE": 0x2006,
    "OD_COMPANDING": 0x2007,
    "OD_STATE": 0x2008,
    "OD_GAIN": 0x2010,
    "OD_OFFSET": 0x2011,
    "OD_HEALTH": 0x2020,
    "OD_TEST_PATTERN": 0x2021,
    "OD_REFRESH": 0x2030,
    "OD_SENDING": 0x2031,
    "OD_COEFFICIENT_NOISE": 0x2032,
    "OD_TAXEL_NOISE": 0x2033,
    "OD_BUDGET": 0x2034,
    "OD_NODE_NOISE": 0x2035,
    "OD_TEMPERATURE": 0x2036,
    "OD_SUMS": 0x2100,
    "OD_COARSE": 0x2110,
    "OD_FINE": 0x2111,
}


def named(prefix: str) -> dict[str, int]:
    return {name: value for name, value in vars(dbc.indices).items() if name.startswith(prefix)}


def test_indices_are_those_of_the_standard_and_the_documentation() -> None:
    assert named("OD_") == COMMUNICATION | OF_THE_SKIN


def test_data_types_are_those_of_the_standard() -> None:
    assert {name: getattr(dbc.indices, name) for name in DATA_TYPES} == DATA_TYPES
    assert set(dbc.indices.SIGNED) == {2, 3}
    assert dbc.indices.BITS == {2: 8, 3: 16, 5: 8, 6: 16, 7: 32, 8: 32, 0x1B: 64}


def test_signatures_are_words_with_the_first_letter_lowest() -> None:
    assert SIGNATURE_SAVE.to_bytes(4, "little") == b"save"
    assert SIGNATURE_LOAD.to_bytes(4, "little") == b"load"


@pytest.mark.parametrize(
    ("first", "place", "index"),
    [(0x2003, 0, 0x2003), (0x2003, 1, 0x2203), (0x2100, 3, 0x2700), (0x2000, 7, 0x2E00), (0x21FF, 7, 0x2FFF)],
)
def test_objects_of_further_blocks_are_200h_apart(first: int, place: int, index: int) -> None:
    assert of_block(first, place) == index
    assert split_block(index) == (place, first)
