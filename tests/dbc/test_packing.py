"""Packings of 7 to 16 bits: nothing saturates, the rounding error is what it says, and what is packed comes back."""

from itertools import product

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dbc.codec import decode, encode
from dbc.packing import Packing, packing, rounding_error_n
from skin.layout import SUM_BITS_MAX, SUM_BITS_MIN, Layout, load_layout

TRIPS = 10_000
WIDTHS = range(SUM_BITS_MIN, SUM_BITS_MAX + 1)
ENCODINGS = list(product(WIDTHS, (False, True)))
#: SYNC counter of the frames: its highest bit is set.
COUNTER = 0xA5


def layout_with(bits: int, offset_binary: bool, adc_bits: int = 10, block_size: int = 32, **taxels: str) -> Layout:
    layout = load_layout()
    replace = msgspec.structs.replace
    return replace(
        layout,
        encoding=replace(layout.encoding, sum_bits=bits, offset_binary=offset_binary),
        taxels=replace(layout.taxels, adc_bits=adc_bits, **taxels),
        measurement=replace(layout.measurement, block_size=block_size),
    )


@pytest.mark.parametrize(
    ("bits", "offset_binary", "adc_bits", "scale", "offset"),
    [
        (16, False, 10, 1, 0),
        (16, True, 10, 1, 0x5555),
        (16, False, 12, 4, 0),
        (16, True, 12, 4, 0x5555),
        (16, False, 16, 64, 0),
        (15, False, 10, 2, 0),
        (14, False, 10, 4, 0),
        # 5461 of 16384 codes are below zero, 10922 above: 32736 / 4 = 8184 of them are used.
        (14, True, 10, 4, 0x1555),
        (13, True, 10, 8, 0xAAA),
        (12, False, 10, 16, 0),
        (12, True, 10, 16, 0x555),
        (12, False, 12, 64, 0),
        # 32736 / 256 rounds to 128, one more than a signed byte holds; the offset divides the range as sums need it.
        (8, False, 10, 512, 0),
        (8, True, 10, 256, 0x55),
        (7, False, 10, 1024, 0),
        (7, True, 10, 512, 0x2A),
    ],
)
def test_scale_is_the_smallest_that_fits(
    bits: int, offset_binary: bool, adc_bits: int, scale: int, offset: int
) -> None:
    assert packing(layout_with(bits, offset_binary, adc_bits)) == Packing(bits, scale, offset)


@pytest.mark.parametrize(
    ("bits", "adc_bits", "scale"), [(16, 10, 32), (12, 12, 32), (12, 10, 32), (8, 12, 32 << 4), (16, 16, 32)]
)
def test_the_scale_of_analogue_sums_is_the_step_of_their_converter_or_a_multiple(
    bits: int, adc_bits: int, scale: int
) -> None:
    pack = packing(layout_with(bits, False, adc_bits, frontend="analogue"))
    ends = np.array([-(1 << adc_bits - 1), (1 << adc_bits - 1) - 1]) * 32
    low, high = pack.raw_range
    assert pack.scale == scale
    assert low <= pack.raw(ends)[0]
    assert pack.raw(ends)[1] <= high
    inner = pack.counts(pack.raw(np.array([*ends, 0, ends[1] - 2 * scale])))
    assert np.frombuffer(pack.usable(inner), np.uint8).tolist() == [0, 0, 1, 1]
    assert pack.usable(inner[2:]) == b""


@pytest.mark.parametrize(("bits", "adc_bits", "scale"), [(8, 10, 256), (12, 10, 32), (12, 12, 64), (16, 16, 64)])
def test_offset_binary_leaves_a_third_of_the_codes_to_analogue_sums_below_zero(
    bits: int, adc_bits: int, scale: int
) -> None:
    """-16384 counts are -64 steps of 256, of the 85 below zero; of 128 counts they would be -128. A converter of 12
    bits has -2048 codes of 32 counts below zero, and 12 bits 1365 steps.
    """
    pack = packing(layout_with(bits, True, adc_bits, frontend="analogue"))
    assert (pack.scale, pack.offset) == (scale, (2**bits - 1) // 3)
    ends = np.array([-(1 << adc_bits - 1), (1 << adc_bits - 1) - 1]) * 32
    assert pack.raw(ends).min() >= 0
    assert pack.raw(ends).max() < 2**bits
    back = pack.counts(pack.raw(ends))
    assert np.abs(back - ends).max() <= scale // 2 == pack.rounding_counts


@given(st.sampled_from(ENCODINGS), st.integers(1, 16), st.sampled_from([2, 4, 8, 16, 32, 64, 128]))
def test_no_sum_of_any_touch_saturates(encoding: tuple[int, bool], adc_bits: int, block_size: int) -> None:
    layout = layout_with(*encoding, adc_bits, block_size)
    pack, top = packing(layout), (1 << adc_bits) - 1
    low, high = pack.raw_range
    # The largest and the smallest sum of every Hadamard row: the taxels under its +1 or its -1 at full scale.
    rows = np.array([[(-1) ** (row & place).bit_count() for place in range(block_size)] for row in range(block_size)])
    extremes = np.concatenate((np.clip(rows, 0, 1).sum(1), np.clip(rows, -1, 0).sum(1))) * top
    raw = pack.raw(extremes)
    assert low <= raw.min()
    assert raw.max() <= high


@pytest.mark.parametrize(("bits", "offset_binary"), ENCODINGS)
def test_ten_thousand_round_trips(bits: int, offset_binary: bool) -> None:
    layout = layout_with(bits, offset_binary)
    pack = packing(layout)
    width = 56 // bits
    random = np.random.default_rng(bits)
    sums = random.integers(-16368, 32737, TRIPS * width).astype(np.int32)
    sums[:4] = -16368, 32736, 0, -1
    gather = random.permutation(TRIPS * width).reshape(TRIPS, width)
    payloads = encode(COUNTER, sums, gather, pack)
    assert payloads.shape == (TRIPS, 1 + (width * bits + 7) // 8)
    assert (payloads[:, 0] == COUNTER).all()
    back = np.zeros_like(sums)
    decode(payloads, gather, pack, back)
    error = np.abs(back - sums)
    assert error.max() == pack.rounding_counts  # reached, and not passed
    assert np.array_equal(pack.raw(back), pack.raw(sums))
    assert (error == 0).all() == (pack.scale == 1)
    assert rounding_error_n(layout) == pytest.approx(error.max() * 0.02 / 1023)


def test_halves_round_towards_zero() -> None:
    pack = Packing(12, 16, 0)
    assert pack.raw(np.array([8, 24, 40, -8, -24, 7, 9, -7, -9])).tolist() == [0, 1, 2, 0, -1, 0, 1, 0, -1]


@given(st.data(), st.integers(SUM_BITS_MIN, SUM_BITS_MAX), st.booleans(), st.integers(0, 255))
def test_a_payload_is_its_counter_and_one_number_of_all_sums(
    data: st.DataObject, bits: int, offset_binary: bool, counter: int
) -> None:
    """The packer of frames of CAN FD, too: 63 bytes of sums, 63 sums at most."""
    pack = Packing(bits, 1, (2**bits - 1) // 3 if offset_binary else 0)
    low, high = (
        (-pack.offset, 2**bits - 1 - pack.offset) if offset_binary else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
    )
    values = data.draw(st.lists(st.integers(low, high), min_size=1, max_size=min(504 // bits, 63)))
    sums, gather = np.array(values, np.int32), np.arange(len(values))[None]
    payload = encode(counter, sums, gather, pack)
    number = sum(((value + pack.offset) % 2**bits) << place * bits for place, value in enumerate(values))
    wanted = counter.to_bytes() + number.to_bytes(-(-len(values) * bits // 8), "little")
    assert payload.tobytes() == wanted
    back = np.zeros(len(values), np.int32)
    decode(np.pad(payload, ((0, 0), (0, 64 - len(wanted))), constant_values=0xFF), gather, pack, back)
    assert back.tolist() == values


@pytest.mark.parametrize("bits", WIDTHS)
def test_offset_binary_of_an_idle_skin_has_no_run_to_stuff(bits: int) -> None:
    """Even widths alternate throughout; of an odd width the last bit of a sum and the first of the next are 0."""
    pack = packing(layout_with(bits, offset_binary=True))
    sums = 56 // bits
    payload = encode(COUNTER, np.zeros(sums, np.int32), np.arange(sums)[None], pack)[0, 1:]
    idle = "".join(map(str, np.unpackbits(payload, bitorder="little")[: sums * bits]))
    assert "11" not in idle
    assert "000" not in idle
    assert idle.count("00") == (sums - 1 if bits % 2 else 0)
