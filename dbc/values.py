"""The value in the bytes that a device answers, by the object's data type (CiA 301, 7.1.4)."""

import struct

from dbc import indices as od


def value_bytes(data_type: int, data: bytes, *, has_size: bool = True) -> bytes:
    """Return the bytes of a value, as many as its type has.

    Devices answer a number with more bytes than its type has, and an unsigned one with fewer. The zeros behind a text
    are no part of it. Of a type that `dbc.indices.BITS` does not have, the bytes are as they came.

    Parameters
    ----------
    has_size : bool
        Whether the device has told the size; in a frame without, bytes behind the value mean nothing (CiA 301,
        7.2.4.3.6).

    Raises
    ------
    ValueError
        If the bytes are no value of the type.
    """
    if data_type == od.VISIBLE_STRING:
        return data.rstrip(b"\0")
    if data_type not in od.BITS:
        return data
    size = -(-od.BITS[data_type] // 8)
    value, rest = data[:size], data[size:]
    if data and data_type in od.UNSIGNED:
        value = value.ljust(size, b"\0")
    is_filled = not rest.strip(b"\0") or (data_type in od.SIGNED and value[-1] & 0x80 and not rest.strip(b"\xff"))
    if len(value) == size and (is_filled or not has_size):
        return value
    raise ValueError(f"expected {size} byte{'s' * (size > 1)}, got {data.hex(' ') or 'none'}")


def decode(data_type: int, data: bytes) -> int | float | str | bool:
    """Return the value of what `value_bytes` has returned, of other types the bytes in hexadecimal."""
    if data_type == od.VISIBLE_STRING:
        return data.decode("ascii", "replace")
    if data_type == od.UNICODE_STRING:
        return data.decode("utf-16-le", "replace").rstrip("\0")
    if data_type == od.BOOLEAN:
        return any(data)
    if data_type in od.REALS:
        return float(struct.unpack(od.REALS[data_type], data)[0])
    if data_type in od.BITS:
        return int.from_bytes(data, "little", signed=data_type in od.SIGNED)
    return data.hex(" ")
