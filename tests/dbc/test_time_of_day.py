"""TIME: the wall clock as CiA 301 lays it out."""

from datetime import UTC, datetime, timedelta

import cantools.database
import msgspec
import pytest

from dbc.contract import Contract
from dbc.database import database as dbc_text
from dbc.time_of_day import time_frame, time_of_day
from skin.layout import load_layout

BEGIN = datetime(1984, 1, 1, tzinfo=UTC)


@pytest.mark.parametrize(
    ("instant", "data"),
    [
        (BEGIN, "00 00 00 00 00 00"),
        (BEGIN + timedelta(days=1, milliseconds=1), "01 00 00 00 01 00"),
        (BEGIN + timedelta(days=0x3B42, hours=23, minutes=59, seconds=59, milliseconds=999), "ff 5b 26 05 42 3b"),
    ],
)
def test_milliseconds_after_midnight_and_days_since_1984(instant: datetime, data: str) -> None:
    wall_ns = round(instant.timestamp() * 1000) * 1_000_000
    assert time_of_day(wall_ns) == bytes.fromhex(data)
    assert time_of_day(wall_ns + 999_999) == bytes.fromhex(data)


@pytest.mark.heavy
def test_the_dbc_decodes_time_if_the_layout_has_it() -> None:
    layout = load_layout()
    timed = msgspec.structs.replace(layout, sync=msgspec.structs.replace(layout.sync, time_s=2.5))
    frame = time_frame(1_750_000_000_123_456_789)[0]
    known = cantools.database.load_string(dbc_text(Contract.from_layout(timed), 0), "dbc")
    read = known.decode_message(int(frame["can_id"]), frame["data"][:6].tobytes())
    assert BEGIN + timedelta(days=read["Days"], milliseconds=read["AfterMidnight"]) == datetime.fromtimestamp(
        1_750_000_000.123, UTC
    )
    assert known.get_message_by_name("TIME").cycle_time == 2500
    without = cantools.database.load_string(dbc_text(Contract.from_layout(layout), 0), "dbc")
    assert "TIME" not in {each.name for each in without.messages}
