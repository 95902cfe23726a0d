"""The gateway against its peers: all of them make complete measurements of the sums that were sent."""

import pytest

from evaluation.bench import gateway


def test_ours_and_peers_make_the_sums_that_were_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gateway, "CYCLES", 1)
    monkeypatch.setattr(gateway, "WAKE_UPS", (8, 64))
    rows = gateway.run(rounds=1)["rows"]
    assert [row["frames a wake-up"] for row in rows] == [8, 64]
    for row in rows:
        assert all(row[f"{name}, frames/s"] > 0 for name in ("canskin", "python-can", "canopen"))
        assert row["ours / python-can"] > 0
