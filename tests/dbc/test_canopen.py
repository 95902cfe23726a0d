"""CANopen's numbers, against another implementation and the standard's text."""

from canopen import SdoAbortedError

import dbc.canopen
from dbc.canopen import Abort


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
