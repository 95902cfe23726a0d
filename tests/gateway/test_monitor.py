"""What the gateway notices on a bus besides sums."""

from dbc.contract import SYNC_COB_ID, Contract
from dbc.frame import ECHO
from gateway.monitor import BusMonitor
from skin.layout import load_layout
from tests.bus.harness import frame


def test_only_the_sync_of_somebody_else_is_foreign() -> None:
    monitor = BusMonitor(Contract.from_layout(load_layout()), 0, 1.0)
    monitor.take(frame(SYNC_COB_ID, b"\1", ECHO))
    assert monitor.foreign_syncs == 0
    monitor.take(frame(SYNC_COB_ID, b"\2"))
    assert monitor.foreign_syncs == 1
