"""The value in what a device answers, by its type."""

import pytest
from canopen.objectdictionary import ODVariable
from hypothesis import given
from hypothesis import strategies as st

from dbc import indices as od
from dbc.values import decode, value_bytes


@given(st.sampled_from(sorted(od.BITS)), st.data())
def test_a_value_is_the_same_with_and_without_size_and_in_more_bytes(data_type: int, data: st.DataObject) -> None:
    variable = ODVariable("", 0x3000)
    variable.data_type = data_type
    size = -(-od.BITS[data_type] // 8)
    sent = data.draw(st.binary(min_size=size, max_size=size))
    fill = b"\xff" if data_type in od.SIGNED and sent[-1] & 0x80 else b"\0"
    assert value_bytes(data_type, sent) == value_bytes(data_type, sent + 3 * fill) == sent
    rest = data.draw(st.binary(max_size=max(4 - size, 0)))
    assert value_bytes(data_type, sent + rest, has_size=False) == sent
    if data_type != od.BOOLEAN:
        assert repr(decode(data_type, sent)) == repr(variable.decode_raw(sent))


@pytest.mark.parametrize(
    ("data_type", "sent", "has_size", "value"),
    [
        (od.UNSIGNED16, "91010000", False, 401),
        (od.UNSIGNED8, "91010000", False, 0x91),
        (od.UNSIGNED32, "91", True, 0x91),
        (od.INTEGER16, "feff0000", True, -2),
        (od.BOOLEAN, "02000000", True, True),
        (od.VISIBLE_STRING, "312e3000", False, "1.0"),
        (od.VISIBLE_STRING, "", True, ""),
        (od.UNICODE_STRING, "41000000", True, "A"),
        (od.DOMAIN, "91010000", False, "91 01 00 00"),
    ],
)
def test_values_of_other_lengths(data_type: int, sent: str, has_size: bool, value: object) -> None:
    got = decode(data_type, value_bytes(data_type, bytes.fromhex(sent), has_size=has_size))
    assert (type(got), got) == (type(value), value)


@pytest.mark.parametrize(
    ("data_type", "sent", "says"),
    [
        (od.UNSIGNED16, "91010100", "expected 2 bytes, got 91 01 01 00"),
        (od.UNSIGNED8, "", "expected 1 byte, got none"),
        (od.INTEGER16, "ff", "expected 2 bytes, got ff"),
        (od.INTEGER16, "0100ffff", "expected 2 bytes"),
        (od.REAL32, "0000", "expected 4 bytes"),
        (0x1B, "0102030405060708ff", "expected 8 bytes"),
        (0x11, "01020304", "expected 8 bytes"),
    ],
)
def test_bytes_that_are_no_value_are_refused(data_type: int, sent: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        value_bytes(data_type, bytes.fromhex(sent))
