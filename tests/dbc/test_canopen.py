"""CANopen's numbers, against another implementation and the standard's text."""

import numpy as np
from canopen import SdoAbortedError
from canopen.emcy import EmcyError
from canopen.nmt import COMMAND_TO_STATE, NMT_COMMANDS

import dbc.canopen
from dbc.canopen import (
    COB_ID_EXTENDED,
    COB_ID_INVALID,
    COB_ID_NO_RTR,
    COMMANDED,
    RESTRICTED_COB_IDS,
    Abort,
    Emergency,
    ErrorRegister,
    NmtCommand,
    is_of_node,
)


def test_abort_codes_are_those_of_the_standard() -> None:
    words = {
        Abort.TOGGLE: "toggle bit",
        Abort.TIMEOUT: "Timeout",
        Abort.COMMAND: "Unknown SDO command",
        Abort.CRC: "CRC error",
        Abort.MEMORY: "Out of memory",
        Abort.WRITE_ONLY: "Attempt to read a write only object",
        Abort.READ_ONLY: "Attempt to write a read only object",
        Abort.NO_OBJECT: "Object does not exist",
        Abort.NOT_MAPPABLE: "cannot be mapped",
        Abort.PDO_LENGTH: "PDO length exceeded",
        Abort.INCOMPATIBLE: "General parameter incompatibility",
        Abort.HARDWARE: "hardware error",
        Abort.LENGTH: "length code do not match",
        Abort.TOO_LONG: "length of service parameter too high",
        Abort.NO_SUBINDEX: "Subindex does not exist",
        Abort.VALUE: "Value range of parameter exceeded",
        Abort.NOT_STORED: "cannot be transferred or stored to the application",
        Abort.STATE: "present device state",
        Abort.NO_DATA: "No data available",
    }
    assert set(words) == set(Abort)
    assert 0x0504_0005 < dbc.canopen.FIRST_ABORT_OF_THE_OBJECT == 0x0600_0000
    assert [code for code, text in words.items() if text not in SdoAbortedError.CODES[code]] == []


def test_nmt_commands_are_those_of_the_standard() -> None:
    assert {command.value for command in NmtCommand} == set(NMT_COMMANDS.values()) - {NMT_COMMANDS["SLEEP"]} - {
        NMT_COMMANDS["STANDBY"]
    }
    assert [NmtCommand.START, NmtCommand.STOP, NmtCommand.ENTER_PRE_OPERATIONAL] == [1, 2, 128]
    assert [NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION] == [129, 130]


def test_identifiers_are_those_of_the_predefined_connection_set() -> None:
    """CiA 301, 7.3.5, and docs/bus.md."""
    names = "NMT_COB_ID SYNC_COB_ID TIME_COB_ID EMCY_BASE SDO_RESPONSE_BASE SDO_REQUEST_BASE HEARTBEAT_BASE"
    found = [getattr(dbc.canopen, name) for name in names.split()]
    assert found == [0x000, 0x080, 0x100, 0x080, 0x580, 0x600, 0x700]
    assert dbc.canopen.TPDO_BASES == (0x180, 0x280, 0x380, 0x480, 0x200, 0x300, 0x400, 0x500)
    assert dbc.canopen.HIGHEST_NODE_ID == 127


def test_a_base_has_the_identifiers_of_nodes_1_to_127() -> None:
    identifiers = np.array([0x57F, 0x580, 0x581, 0x5FF, 0x600], np.uint32)
    assert is_of_node(identifiers, 0x580).tolist() == [False, False, True, True, False]


def test_transmission_types_and_lengths_are_those_of_the_standard() -> None:
    """CiA 301, 7.5.2.38: 1 to 240 are cyclic and synchronous, 254 and 255 event-driven; lengths of 7.2."""
    assert (dbc.canopen.LAST_SYNCHRONOUS, dbc.canopen.EVENT_MANUFACTURER) == (240, 254)
    lengths = [getattr(dbc.canopen, f"{name}_BYTES") for name in ("NMT", "SDO", "EMCY", "HEARTBEAT")]
    assert lengths == [2, 8, 8, 1]


def test_bits_of_the_error_register() -> None:
    """CiA 301, 7.5.2.2: bit 0 generic error, bit 4 communication error, bit 7 of the manufacturer."""
    assert {each.name: each.value for each in ErrorRegister} == {
        "GENERIC": 1 << 0,
        "COMMUNICATION": 1 << 4,
        "MANUFACTURER": 1 << 7,
    }


def test_bits_of_a_cob_id_object() -> None:
    assert [COB_ID_INVALID, COB_ID_NO_RTR, COB_ID_EXTENDED] == [1 << 31, 1 << 30, 1 << 29]
    assert (dbc.canopen.BASE_ID_MASK, dbc.canopen.EXTENDED_ID_MASK) == (0x7FF, 0x1FFF_FFFF)


def test_emergencies_belong_to_the_groups_of_the_standard() -> None:
    said = {code: EmcyError(code, 0, b"", 0.0).get_desc() for code in Emergency}
    assert said[Emergency.NONE] == "Error Reset / No Error"
    assert said[Emergency.WINDOW_MISSED] == "Device Specific"
    assert Emergency.WINDOW_MISSED == 0xFF10  # docs/bus.md
    assert Emergency.HEARTBEAT_LOST == 0x8130  # CiA 301, table 26: life guard error or heartbeat error
    assert Emergency.SYNC_LENGTH == 0x8240  # unexpected SYNC data length


def test_restricted_identifiers_are_those_of_the_standard() -> None:
    """CiA 301, table 38: NMT to the flying master, SDO, dynamic SDO, error control; 80h, 180h, 580h, 600h are free."""
    ends = [(each[0], each[-1]) for each in RESTRICTED_COB_IDS]
    assert ends == [(0x001, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF)]


def test_a_command_leads_to_the_state_that_canopen_has() -> None:
    assert {int(command): int(state) for command, state in COMMANDED.items()} == {
        command: COMMAND_TO_STATE[command] for command in (1, 2, 128)
    }
