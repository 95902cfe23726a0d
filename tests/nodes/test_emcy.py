"""Emergencies: once when an error comes, once when it goes, and never faster than the inhibit time."""

from dbc.canopen import Emergency, ErrorRegister
from nodes.emcy import EMCY, EmcyProducer


def test_an_error_is_sent_once_and_again_when_it_has_gone() -> None:
    sent: list[bytes] = []
    emcy = EmcyProducer(sent.append)
    for _ in range(3):
        emcy.raised(Emergency.SYNC_LENGTH, 0)
    emcy.flush(0.0, 0.0)
    assert [EMCY.unpack(one)[:2] for one in sent] == [(0x8240, ErrorRegister.GENERIC | ErrorRegister.COMMUNICATION)]
    emcy.gone(Emergency.SYNC_LENGTH)
    emcy.gone(Emergency.SYNC_LENGTH)
    emcy.flush(0.0, 0.0)
    assert [EMCY.unpack(one)[:2] for one in sent[1:]] == [(0x0000, 0)]
    assert emcy.register == 0


def test_error_register_holds_every_active_error() -> None:
    emcy = EmcyProducer(lambda _: None)
    emcy.raised(Emergency.HEARTBEAT_LOST, 5)
    emcy.raised(Emergency.WINDOW_MISSED, 3)
    assert emcy.register == ErrorRegister.GENERIC | ErrorRegister.COMMUNICATION | ErrorRegister.MANUFACTURER
    emcy.gone(Emergency.HEARTBEAT_LOST)
    assert emcy.register == ErrorRegister.GENERIC | ErrorRegister.MANUFACTURER


def test_history_is_newest_first_bounded_and_can_be_cleared() -> None:
    emcy = EmcyProducer(lambda _: None)
    for number in range(12):
        emcy.raised(Emergency.WINDOW_MISSED, number)
        emcy.gone(Emergency.WINDOW_MISSED)
    assert len(emcy.history) == 8
    assert emcy.history[0] == 11 << 16 | 0xFF10
    emcy.clear_history()
    assert emcy.history == []


def test_inhibit_time_spreads_messages() -> None:
    sent: list[bytes] = []
    emcy = EmcyProducer(sent.append)
    emcy.raised(Emergency.SYNC_LENGTH)
    emcy.raised(Emergency.HEARTBEAT_LOST)
    emcy.flush(0.0, 0.1)
    emcy.flush(0.05, 0.1)
    assert len(sent) == 1
    emcy.flush(0.1, 0.1)
    assert len(sent) == 2


def test_reset_forgets_errors_and_messages_that_wait() -> None:
    sent: list[bytes] = []
    emcy = EmcyProducer(sent.append)
    emcy.raised(Emergency.SYNC_LENGTH, 3)
    emcy.reset()
    emcy.flush(1.0, 0.0)
    assert (sent, emcy.register, emcy.history, emcy.is_waiting) == ([], 0, [], False)
    emcy.raised(Emergency.SYNC_LENGTH, 3)
    emcy.flush(1.0, 0.0)
    assert len(sent) == 1
