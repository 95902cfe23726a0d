"""Reports of errors, byte by byte as Linux has them in ``include/uapi/linux/can/error.h``."""

import pytest

from bus.error_frames import State, ack_report, bit_report, state_report
from dbc.frame import ERROR, Frames

CRTL, PROT, ACK, BUSOFF, BUSERROR, RESTARTED, CNT = 0x004, 0x008, 0x020, 0x040, 0x080, 0x100, 0x200


@pytest.mark.parametrize(
    ("report", "why", "data"),
    [
        (state_report(State.WARNING, 96, 0), CRTL | CNT, "00 08 00 00 00 00 60 00"),
        (state_report(State.WARNING, 0, 97), CRTL | CNT, "00 04 00 00 00 00 00 61"),
        (state_report(State.PASSIVE, 128, 5), CRTL | CNT, "00 20 00 00 00 00 80 05"),
        (state_report(State.PASSIVE, 5, 128), CRTL | CNT, "00 10 00 00 00 00 05 80"),
        (state_report(State.ACTIVE, 95, 94), CRTL | CNT, "00 40 00 00 00 00 5f 5e"),
        (state_report(State.ACTIVE, 0, 0, restarted=True), CRTL | RESTARTED | CNT, "00 40 00 00 00 00 00 00"),
        (state_report(State.BUS_OFF, 256, 3), BUSOFF | CNT, "00 00 00 00 00 00 ff 03"),
        (ack_report(8, 0), ACK | BUSERROR | CNT, "00 00 80 19 00 00 08 00"),
        (bit_report(8, 300), PROT | BUSERROR | CNT, "00 00 81 00 00 00 08 ff"),
    ],
)
def test_reports_have_the_bytes_of_socketcan(report: Frames, why: int, data: str) -> None:
    (one,) = report
    assert (one["can_id"], one["flags"], one["length"]) == (why, ERROR, 8)
    assert one["data"][:8].tobytes().hex(" ") == data
