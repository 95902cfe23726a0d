"""Two published tables of SYNC rates, figure by figure."""

import pytest

from bandwidth.mean_bits import mean_wire_bits
from bandwidth.plan import sync_bits
from bandwidth.scheme_rates import Scheme, schemes
from skin.layout import load_layout

#: Rows of classic CAN at 1 Mbit/s: values, bits, blocks per node, frames a cycle, then average and worst on one, two
#: and four buses, and the worst at 80 % on four.
CLASSIC = """
sums 16 1 256   33.9 28.6   67.9 57.4   135.6 114.6    92
sums 12 1 256   39.6 33.6   79.3 67.4   158.2 134.4   108
sums  8 1 128   67.7 57.2  135.3 114.4  269.0 227.6   182
sums 12 2 192   45.3 38.3   90.6 76.6   180.4 152.6   122
sums 16 4 256   34.1 28.8   68.1 57.6   135.7 114.8    92
sums  8 4 128   68.0 57.5  135.7 114.8  269.4 227.9   182
taxels 10 1 640   13.6 11.5   27.2 23.0   54.5 46.1    37
taxels 12 1 768   11.3  9.6   22.7 19.2   45.4 38.4    31
taxels 16 1 1024   8.5  7.2   17.0 14.4   34.1 28.8    23
"""
#: Rows of CAN FD: values, bits, blocks per node, longest frame, payloads, then average and worst with 5 Mbit/s on one
#: and four buses, and with 8 Mbit/s.
FAST = """
sums 16 1 64 16     124 109   487 431   154 137   603 537
sums 16 2 64 32     172 149   669 581   229 200   884 774
sums 16 4 64 64     216 184   833 711   306 263  1164 1000
sums 16 8 64 64+64  216 184   834 711   306 263  1164 1001
sums 12 1 64 12     138 123   543 484   168 150   655 588
sums 12 2 64 24     201 176   779 681   261 230  1001 882
sums 12 4 64 48     264 227  1013 870   365 316  1377 1193
sums 12 8 64 64+32  264 227  1013 870   365 316  1377 1192
sums  8 1 64 8      156 141   613 551   184 166   718 648
sums  8 2 64 16     246 218   948 838   306 273  1167 1040
sums  8 4 64 32     341 296  1290 1120  453 396  1684 1474
sums  8 8 64 64     427 364  1592 1359  602 517  2184 1879
sums 16 8  8 8+8+8+8+8+8+8+8+8+8+8+8+8+8+8+8  79 71  312 281  93 84  367 331
sums 16 8 16 16+16+16+16+16+16+16+16  124 110  487 431  155 138  604 538
sums 16 8 32 32+32+32+32  172 149  669 581  230 201  884 774
taxels 10 1 64 48    66  57   264 227    92  80   365 316
taxels 12 1 64 48    66  57   264 227    92  80   365 316
taxels 16 1 64 64    54  46   216 184    77  66   306 263
"""


@pytest.fixture(scope="module")
def every() -> dict[tuple[object, ...], Scheme]:
    return {
        (each.what, each.bits, each.blocks_per_node, each.buses, each.data_bitrate, each.most_bytes): each
        for each in schemes(load_layout())
    }


def rows(table: str) -> list[list[str]]:
    return [line.split() for line in table.strip().splitlines()]


def near(found: float, text: str) -> None:
    assert found == pytest.approx(float(text), rel=0.01), text


@pytest.mark.parametrize("row", rows(CLASSIC))
def test_classic_table(row: list[str], every: dict[tuple[object, ...], Scheme]) -> None:
    what, bits, per_node, frames_per_cycle = row[0], int(row[1]), int(row[2]), int(row[3])
    for place, buses in enumerate((1, 2, 4)):
        scheme = every[what, bits, per_node, buses, None, 8]
        assert scheme.frames_per_cycle == frames_per_cycle
        near(scheme.max_rate_hz_random, row[4 + 2 * place])
        near(scheme.max_rate_hz_worst, row[5 + 2 * place])
    near(scheme.max_rate_hz_worst_80, row[10])


@pytest.mark.parametrize("row", rows(FAST))
def test_fast_table(row: list[str], every: dict[tuple[object, ...], Scheme]) -> None:
    what, bits, per_node, most, payloads = row[0], int(row[1]), int(row[2]), int(row[3]), row[4]
    places = iter(row[5:])
    for rate in (5_000_000, 8_000_000):
        for buses in (1, 4):
            scheme = every[what, bits, per_node, buses, rate, most]
            assert "+".join(map(str, scheme.payloads)) == payloads
            near(scheme.max_rate_hz_random, next(places))
            near(scheme.max_rate_hz_worst, next(places))


def test_node_ids_are_told(every: dict[tuple[object, ...], Scheme]) -> None:
    assert not every["sums", 16, 1, 1, None, 8].fits_node_ids
    assert every["sums", 16, 1, 2, None, 8].fits_node_ids


def test_a_rate_is_that_of_a_bus_filled_with_one_sync_frames_and_a_heartbeat_a_second(
    every: dict[tuple[object, ...], Scheme],
) -> None:
    one = every["sums", 12, 1, 1, None, 8]
    assert (one.nodes, one.payloads) == (128, [8, 4])
    cycle_bits = 128 * (mean_wire_bits(8)[0] + mean_wire_bits(4)[0]) + sync_bits(1)
    beat_bits = 128 * mean_wire_bits(1)[0]
    assert one.max_rate_hz_random == pytest.approx((1e6 - beat_bits) / cycle_bits, rel=1e-9)
