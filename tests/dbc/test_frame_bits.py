"""Frame lengths against published formulas and tables, and against a slow bit-string implementation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.frame import BRS, ERROR, ESI, EXTENDED, FD, FD_LENGTHS, REMOTE, Frames, frames
from dbc.frame_bits import INTERMISSION_BITS, frame_time_ns, nominal_ns, wire_bits


def frame(can_id: int, data: bytes = b"", flags: int = 0, length: int | None = None) -> Frames:
    one = frames(1)
    one["can_id"], one["flags"] = can_id, flags
    one["length"] = len(data) if length is None else length
    one["data"][0, : len(data)] = np.frombuffer(data, np.uint8)
    return one


def stuffed(bits: str) -> str:
    """Insert a complementary bit after five equal ones."""
    out: list[str] = []
    for bit in bits:
        out.append(bit)
        if len(out) >= 5 and len(set(out[-5:])) == 1 and clean_run(out):
            out.append("1" if bit == "0" else "0")
    return "".join(out)


def clean_run(out: list[str]) -> bool:
    """Tell whether the run at the end is exactly five long: stuffing never lets it be six."""
    return len(out) == 5 or out[-6] != out[-1]


def crc15(bits: str) -> str:
    """Divide the polynomial, on paper: the remainder of bits * x^15."""
    register = [int(bit) for bit in bits] + [0] * 15
    divisor = [int(bit) for bit in f"{0x8000 | 0x4599:016b}"]
    for place in range(len(bits)):
        if register[place]:
            for offset, bit in enumerate(divisor):
                register[place + offset] ^= bit
    return "".join(map(str, register[-15:]))


def head_bits(can_id: int, *, extended: bool, rtr: str) -> str:
    if not extended:
        return "0" + f"{can_id:011b}" + rtr + "0"
    return "0" + f"{can_id >> 18:011b}" + "11" + f"{can_id & 0x3FFFF:018b}" + rtr


def slow_classic(can_id: int, data: bytes, *, extended: bool, remote: bool, dlc: int) -> int:
    bits = head_bits(can_id, extended=extended, rtr=str(int(remote)))
    bits += ("00" if extended else "0") + f"{dlc:04b}" + ("" if remote else bytes_bits(data))
    return len(stuffed(bits + crc15(bits))) + 13


def slow_fd(can_id: int, data: bytes, *, extended: bool, brs: bool, esi: bool) -> tuple[int, int]:
    before = head_bits(can_id, extended=extended, rtr="0") + "10"
    after = f"{int(brs)}{int(esi)}{FD_LENGTHS.index(len(data)):04b}" + bytes_bits(data)
    whole = stuffed(before + after)
    if whole[-1] != after[-1]:  # a dynamic stuff bit at the very end is the first fixed one
        whole = whole[:-1]
    head = len(stuffed(before))
    checked = 4 + 17 + 6 if len(data) <= 16 else 4 + 21 + 7
    nominal, tail = head + 1, len(whole) - head - 1 + checked + 1
    return (nominal + 12, tail) if brs else (nominal + 12 + tail, 0)


def bytes_bits(data: bytes) -> str:
    return "".join(f"{octet:08b}" for octet in data)


identifiers = st.one_of(
    st.tuples(st.just(0), st.integers(0, 0x7FF)), st.tuples(st.just(EXTENDED), st.integers(0, 0x1FFFFFFF))
)
#: Long runs are what stuffing is about, so half of the payloads are made of 00, FF and their like.
octets = st.one_of(st.integers(0, 255), st.sampled_from([0x00, 0xFF, 0x0F, 0xF0, 0x1F, 0x83, 0x7C, 0x3E]))


@settings(max_examples=150, deadline=None)
@given(identifiers, st.lists(octets, max_size=8).map(bytes), st.booleans())
def test_exact_classic_agrees_with_the_bit_string(identifier: tuple[int, int], data: bytes, remote: bool) -> None:
    flags, can_id = identifier
    nominal, fast = wire_bits(frame(can_id, data, flags | (REMOTE if remote else 0)))
    slow = slow_classic(can_id, data, extended=bool(flags), remote=remote, dlc=len(data))
    assert (nominal[0], fast[0]) == (slow, 0)


@pytest.mark.heavy
@settings(max_examples=150, deadline=None)
@given(identifiers, st.data(), st.sampled_from(FD_LENGTHS), st.booleans(), st.booleans())
def test_exact_fd_agrees_with_the_bit_string(
    identifier: tuple[int, int], draw: st.DataObject, length: int, brs: bool, esi: bool
) -> None:
    flags, can_id = identifier
    data = bytes(draw.draw(st.lists(octets, min_size=length, max_size=length)))
    one = frame(can_id, data, flags | FD | (BRS if brs else 0) | (ESI if esi else 0))
    nominal, fast = wire_bits(one)
    assert (nominal[0], fast[0]) == slow_fd(can_id, data, extended=bool(flags), brs=brs, esi=esi)


@settings(max_examples=100, deadline=None)
@given(identifiers, st.lists(octets, max_size=64).map(bytes), st.sampled_from([0, REMOTE, FD, FD | BRS]))
def test_exact_lies_between_none_and_worst(identifier: tuple[int, int], data: bytes, kind: int) -> None:
    one = frame(identifier[1], data if kind & FD else data[:8], identifier[0] | kind)
    least, exact, most = (np.array(wire_bits(one, how)) for how in ("none", "exact", "worst"))
    assert (least <= exact).all()
    assert exact.sum() <= most.sum()


@pytest.mark.parametrize("length", range(9))
def test_classic_bounds_are_the_published_formulas(length: int) -> None:
    for flags, least, most in (
        (0, 47 + 8 * length, 55 + 10 * length),
        (EXTENDED, 67 + 8 * length, 80 + 10 * length),
    ):
        one = frame(0x123, bytes(length), flags)
        assert wire_bits(one, "none")[0][0] == least
        assert wire_bits(one, "worst")[0][0] == most


def test_remote_frames_carry_no_payload_whatever_their_dlc() -> None:
    assert wire_bits(frame(0x700, flags=REMOTE, length=8), "none")[0][0] == 47
    assert wire_bits(frame(0x700, flags=REMOTE, length=8), "worst")[0][0] == 55


@pytest.mark.parametrize(
    ("length", "data_bits", "worst_data_stuff", "worst_us"),
    [
        (4, 65, 8, 46.6), (8, 97, 16, 54.6), (12, 129, 23, 62.4), (16, 161, 31, 70.4), (20, 198, 40, 79.6),
        (24, 230, 48, 87.6), (32, 294, 63, 103.4), (48, 422, 95, 135.4), (64, 550, 128, 167.6),
    ],
)  # fmt: skip
def test_fd_table(length: int, data_bits: int, worst_data_stuff: int, worst_us: float) -> None:
    one = frame(0x181, bytes(length), FD | BRS)
    assert [int(bits[0]) for bits in wire_bits(one, "none")] == [29, data_bits]
    assert [int(bits[0]) for bits in wire_bits(one, "worst")] == [29 + 3, data_bits + worst_data_stuff]
    assert frame_time_ns(one, 1_000_000, 5_000_000, "worst")[0] == round(worst_us * 1000)


def test_error_reports_are_not_on_the_wire() -> None:
    for stuffing in ("none", "worst", "exact"):
        nominal, fast = wire_bits(frame(0x04, bytes(8), ERROR), stuffing)
        assert (nominal[0], fast[0]) == (0, 0)


def test_mixed_read_only_and_empty_input() -> None:
    mixed = np.concatenate([frame(0x80, b"\x01"), frame(0x1234567, bytes(8), EXTENDED), frame(1, bytes(12), FD | BRS)])
    one_by_one = [wire_bits(mixed[i : i + 1]) for i in range(3)]
    nominal, fast = wire_bits(np.frombuffer(mixed.tobytes(), mixed.dtype))
    assert [(int(a[0]), int(b[0])) for a, b in one_by_one] == list(zip(nominal.tolist(), fast.tolist(), strict=True))
    assert wire_bits(frames(0))[0].shape == (0,)


def test_the_intermission_of_iso_11898_is_three_bits() -> None:
    assert INTERMISSION_BITS == 3
    assert [nominal_ns(bits, 300_000) for bits in (1, 3)] == [3333, 10_000]


@pytest.mark.parametrize("kind", [FD, FD | BRS, FD | ESI, FD | BRS | ESI])
def test_the_worst_frame_of_can_fd_without_data_is_that_of_one_identifier(kind: int) -> None:
    """Of all 2048 identifiers; ESI is recessive, and so breaks the run of dominant bits before a DLC of 0."""
    every = frames(2048)
    every["can_id"], every["flags"] = np.arange(2048), kind
    exact = list(zip(*(bits.tolist() for bits in wire_bits(every)), strict=True))
    assert [tuple(int(bits[0]) for bits in wire_bits(every[:1], "worst"))] == [max(exact)]


@pytest.mark.parametrize(
    ("length", "kind", "stuff"),
    [(0, 0, 1), (0, BRS, 0), (0, ESI, 0), (8, 0, 16), (48, 0, 95), (48, ESI, 95), (48, BRS | ESI, 97), (64, 0, 128)],
)
def test_an_extended_identifier_has_seven_stuff_bits_at_most_with_can_fd(length: int, kind: int, stuff: int) -> None:
    """19 bits more than 29 at the nominal rate; the data phase has its stuff bits whatever comes before."""
    one = frame(0x123, bytes(length), FD | EXTENDED | kind)
    least, most = (sum(int(bits[0]) for bits in wire_bits(one, how)) for how in ("none", "worst"))
    assert most - least == 7 + stuff
    if kind & BRS:
        assert wire_bits(one, "worst")[0][0] - wire_bits(one, "none")[0][0] == 7
        assert wire_bits(one, "none")[0][0] == 29 + 19


def test_a_classic_frame_has_eight_bytes_at_most_whatever_its_length_says() -> None:
    one = frame(5, bytes(8), length=15)
    assert wire_bits(one, "none")[0][0] == 47 + 64
    assert wire_bits(one, "worst")[0][0] == 55 + 80


def test_times_are_exact_at_any_rate() -> None:
    one = frame(0x123, bytes(8), FD | BRS)
    nominal, data = (int(bits[0]) for bits in wire_bits(one))
    assert frame_time_ns(one, 1)[0] == (nominal + data) * 10**9
    assert frame_time_ns(one, 4, 8)[0] == nominal * 250_000_000 + data * 125_000_000
    classic = frame(0x123, bytes(8))
    assert frame_time_ns(classic, 4)[0] == int(wire_bits(classic)[0][0]) * 250_000_000
    assert nominal_ns(7, 1) == 7_000_000_000
    assert frame_time_ns(one, 1, stuffing="none")[0] == (29 + 97) * 10**9
