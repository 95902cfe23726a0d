"""Emergencies: the register holds every active error, the history the newest of all."""

from dbc.canopen import Emergency, ErrorRegister
from nodes.emcy import EmcyProducer


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
