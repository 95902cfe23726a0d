"""The steps of a master of LSS on a bus, whatever answers there."""

from commissioning.lss_steps import WINDOW_S
from commissioning.serial_commissioning import SerialCommissioning
from dbc.canopen import LSS_BYTES, LSS_REQUEST_COB_ID, LSS_RESPONSE_COB_ID, Lss
from dbc.contract import Contract
from dbc.frame import Frames, one_frame


def test_a_device_that_answers_every_request_of_a_fastscan_ends_it_and_is_named(small: Contract) -> None:
    answers: list[Frames] = []

    def send(request: Frames) -> int:
        if int(request["can_id"][0]) == LSS_REQUEST_COB_ID and int(request["data"][0, 0]) == Lss.FASTSCAN:
            answers.append(one_frame(LSS_RESPONSE_COB_ID, bytes((Lss.IDENTIFIED,)).ljust(LSS_BYTES, b"\0")))
        return len(request)

    now_s = 0.0
    run = SerialCommissioning(small, 0, send, now_s)
    while not run.done:
        now_s += WINDOW_S
        assert now_s < 60.0
        for each in answers:
            run.take(each, now_s)
        answers.clear()
        run.tick(now_s)
    assert run.strangers == [
        "a device answers every request of the fastscan: take it off the bus, then commission again"
    ]
    assert not run.is_whole
