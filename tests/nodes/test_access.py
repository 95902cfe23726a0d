"""Which values objects accept, at both ends of each range, and the rules of PDO records (CiA 301, 7.5.2)."""

import math

import pytest
from canopen import SdoAbortedError

from dbc import indices as od
from nodes.access import check_write
from nodes.segment import Segment
from tests.nodes.helpers import ArrayLink, write

VALUE, STATE, NOT_MAPPABLE = 0x0609_0030, 0x0800_0022, 0x0604_0041
NOT_STORED, INCOMPATIBLE, NO_SUBINDEX = 0x0800_0020, 0x0604_0043, 0x0609_0011


@pytest.mark.parametrize(
    ("index", "allowed", "refused"),
    [
        (0x1003, [0], [1]),
        (0x1005, [0x80], [0x81, 0x4000_0080]),
        (0x1010, [0x6576_6173], [0, 0x6576_6172, 0x6461_6F6C]),  # "save"
        (0x1011, [0x6461_6F6C], [0, 0x6576_6173]),  # "load"
        (0x1029, [0, 1, 2], [3]),
        (0x2010, [0.0, -3e38, 1.0], [math.inf, -math.inf, math.nan]),
        (od.of_block(0x2010, 3), [0.0], [math.inf]),
        (0x2021, [0, 3], [4]),
        (0x2030, [0, 1], [2, 255]),
        (0x2031, [0.0, 1e-30, 3e38], [-1.0, math.inf, math.nan]),
        # Noise in newtons; 0 stands for what is learned.
        (0x2032, [0.0, 1.1e-9, 0.01, 1000.0], [0.9e-9, -0.01, 1000.1, math.nan]),
        (0x2033, [0.0, 1.1e-9, 0.01, 1000.0], [0.9e-9, -0.01, 1000.1, math.nan]),
        (0x1017, [0, 65535], []),
        (0x2011, [-32768, 32767], []),
    ],
)
def test_values_at_the_ends_of_their_ranges(
    in_python: Segment, index: int, allowed: list[float], refused: list[float]
) -> None:
    local = in_python.boards.nodes[0].local
    for value in allowed:
        check_write(local, index, 0, value)
    for value in refused:
        with pytest.raises(SdoAbortedError) as aborted:
            check_write(local, index, 0, value)
        assert aborted.value.code == (NOT_STORED if index in {0x1010, 0x1011} else VALUE)


def test_a_pdo_takes_identifiers_that_are_free(segment: Segment, link: ArrayLink) -> None:
    """None of 29 bits, of another service, or above 7FFh; the identifier stays while the PDO exists."""
    restricted = (0x001, 0x07F, 0x101, 0x180, 0x581, 0x5FF, 0x601, 0x67F, 0x6E0, 0x701, 0x77F, 0x780, 0x7FF)
    for cob_id in (0x2000_0181, 0x181 | 1 << 28, 0x800, 0x000, 0x080, *restricted):
        assert write(segment, link, 0x1800, 1, cob_id, 4) == VALUE, hex(cob_id)
    assert write(segment, link, 0x1800, 1, 0x182, 4) == STATE
    for cob_id in (0x181, 0x4000_0181, 0x8000_0182, 0x8000_0080):
        assert write(segment, link, 0x1800, 1, cob_id, 4) == 0, hex(cob_id)


def test_a_pdo_that_is_off_comes_back_with_any_free_identifier(segment: Segment, link: ArrayLink) -> None:
    for cob_id in (0x081, 0x100, 0x181, 0x57F, 0x680, 0x6DF):
        assert write(segment, link, 0x1800, 1, 0x8000_0181, 4) == 0
        assert write(segment, link, 0x1800, 1, cob_id, 4) == 0


def test_transmission_types_that_are_reserved_or_remote_are_refused(segment: Segment, link: ArrayLink) -> None:
    refused = [every for every in range(256) if write(segment, link, 0x1800, 2, every, 1) == VALUE]
    assert refused == list(range(241, 254))


@pytest.mark.parametrize(("subindex", "size", "code"), [(3, 2, STATE), (5, 2, 0), (6, 1, STATE)])
def test_inhibit_time_and_start_value_change_while_the_pdo_is_off(
    segment: Segment, link: ArrayLink, subindex: int, size: int, code: int
) -> None:
    assert write(segment, link, 0x1800, subindex, 5, size) == code
    assert write(segment, link, 0x1800, 1, 0xC000_0181, 4) == 0
    assert write(segment, link, 0x1800, subindex, 5, size) == 0


def test_a_mapping_changes_while_the_pdo_is_off_and_entries_while_it_is_open(segment: Segment, link: ArrayLink) -> None:
    assert write(segment, link, 0x1A00, 0, 0, 1) == STATE
    assert write(segment, link, 0x1A00, 1, 0x2100_010E, 4) == STATE
    assert write(segment, link, 0x1800, 1, 0xC000_0181, 4) == 0
    assert write(segment, link, 0x1A00, 1, 0x2100_010E, 4) == STATE
    assert write(segment, link, 0x1A00, 0, 0, 1) == 0
    for entry, code in (
        (0x2100_080E, 0),
        (0x1001_0008, 0),
        (0x2100_010F, NOT_MAPPABLE),
        (0x2100_0108, NOT_MAPPABLE),
        (0x2100_000E, NOT_MAPPABLE),  # the number of entries
        (0x2100_090E, NOT_MAPPABLE),  # of eight sums
        (0x1018_0120, NOT_MAPPABLE),
        (0x5000_0008, NOT_MAPPABLE),
        (0x2100_010E, 0),
    ):
        assert write(segment, link, 0x1A00, 1, entry, 4) == code
    assert write(segment, link, 0x1A00, 2, 0, 4) == 0  # an entry may be empty, ...
    assert write(segment, link, 0x1A00, 0, 2, 1) == NOT_MAPPABLE  # ... but not be used
    assert write(segment, link, 0x1A01, 0, 0, 1) == STATE  # another PDO, which exists


def test_no_node_is_watched_twice(segment: Segment, link: ArrayLink) -> None:
    """What is no node-ID may stand twice, and so may a time of 0."""
    for wrong in (0x0000_0100, 0x0080_0064, 0x00FF_0064, 0x7F_0000):
        assert [write(segment, link, 0x1016, place, wrong, 4) for place in (1, 2)] == [0, 0]
    assert write(segment, link, 0x1016, 1, 0x7F_0064, 4) == 0
    assert write(segment, link, 0x1016, 2, 0x7F_0065, 4) == INCOMPATIBLE
    assert write(segment, link, 0x1016, 1, 0x7F_0066, 4) == 0
    entries = 1
    while write(segment, link, 0x1016, entries + 1, (entries + 1) << 16 | 100, 4) == 0:
        entries += 1
    assert entries >= 2
    assert write(segment, link, 0x1016, entries + 1, 0, 4) == NO_SUBINDEX
    assert write(segment, link, 0x1016, 1, entries << 16 | 200, 4) == INCOMPATIBLE
