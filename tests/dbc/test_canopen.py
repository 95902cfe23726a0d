"""CANopen's numbers, against another implementation and the standard's text."""

from canopen import SdoAbortedError
from canopen.emcy import EmcyError
from canopen.nmt import NMT_COMMANDS

from dbc.canopen import (
    COB_ID_EXTENDED,
    COB_ID_INVALID,
    COB_ID_NO_RTR,
    RESTRICTED_COB_IDS,
    Abort,
    Emergency,
    NmtCommand,
)


def test_abort_codes_are_those_of_the_standard() -> None:
    words = {
        Abort.TOGGLE: "toggle bit",
        Abort.TIMEOUT: "Timeout",
        Abort.COMMAND: "Unknown SDO command",
        Abort.MEMORY: "Out of memory",
        Abort.NO_OBJECT: "Object does not exist",
        Abort.NOT_MAPPABLE: "cannot be mapped",
        Abort.PDO_LENGTH: "PDO length exceeded",
        Abort.INCOMPATIBLE: "General parameter incompatibility",
        Abort.HARDWARE: "hardware error",
        Abort.TOO_LONG: "length of service parameter too high",
        Abort.NO_SUBINDEX: "Subindex does not exist",
        Abort.VALUE: "Value range of parameter exceeded",
        Abort.NOT_STORED: "cannot be transferred or stored to the application",
        Abort.STATE: "present device state",
        Abort.NO_DATA: "No data available",
    }
    assert set(words) == set(Abort)
    assert [code for code, text in words.items() if text not in SdoAbortedError.CODES[code]] == []


def test_nmt_commands_are_those_of_the_standard() -> None:
    assert {command.value for command in NmtCommand} == set(NMT_COMMANDS.values()) - {NMT_COMMANDS["SLEEP"]} - {
        NMT_COMMANDS["STANDBY"]
    }
    assert NMT_COMMANDS["RESET"] == NmtCommand.RESET_NODE


def test_bits_of_a_cob_id_object() -> None:
    assert [COB_ID_INVALID, COB_ID_NO_RTR, COB_ID_EXTENDED] == [1 << 31, 1 << 30, 1 << 29]


def test_emergencies_belong_to_the_groups_of_the_standard() -> None:
    said = {code: EmcyError(code, 0, b"", 0.0).get_desc() for code in Emergency}
    assert said[Emergency.NONE] == "Error Reset / No Error"
    assert said[Emergency.WINDOW_MISSED] == "Device Specific"
    assert Emergency.HEARTBEAT_LOST == 0x8130  # CiA 301, table 26: life guard error or heartbeat error
    assert Emergency.SYNC_LENGTH == 0x8240  # unexpected SYNC data length


def test_restricted_identifiers_are_those_of_the_standard() -> None:
    """CiA 301, table 38: NMT to the flying master, SDO, dynamic SDO, error control; 80h, 180h, 580h, 600h are free."""
    ends = [(each[0], each[-1]) for each in RESTRICTED_COB_IDS]
    assert ends == [(0x001, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF)]
