"""Which values objects accept, at both ends of each range, and the rules of PDO records (CiA 301, 7.5.2)."""

import math

import pytest
from canopen import SdoAbortedError

from dbc import indices as od
from dbc.contract import Contract
from nodes.access import _VALUES, check_write
from nodes.segment import Segment
from tests.nodes.helpers import ArrayLink, new_segment, write

VALUE, STATE, NOT_MAPPABLE = 0x0609_0030, 0x0800_0022, 0x0604_0041
NOT_STORED, INCOMPATIBLE, NO_SUBINDEX = 0x0800_0020, 0x0604_0043, 0x0609_0011


def is_allowed(index: int, value: float) -> bool:
    rule = _VALUES.get(od.split_block(index)[1])
    return rule is None or rule(value)


@pytest.mark.parametrize(
    ("index", "allowed", "refused"),
    [
        (0x1003, [0], [1]),
        (0x1005, [0x80], [0x81, 0x4000_0080]),
        (0x1010, [0x6576_6173], [0, 0x6576_6172, 0x6461_6F6C]),  # "save"
        (0x1011, [0x6461_6F6C], [0, 0x6576_6173]),  # "load"
        (0x1019, [0, 2, 240], [1, 241, 255]),
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
def test_values_at_the_ends_of_their_ranges(index: int, allowed: list[float], refused: list[float]) -> None:
    assert [is_allowed(index, value) for value in allowed] == [True] * len(allowed)
    assert [is_allowed(index, value) for value in refused] == [False] * len(refused)


@pytest.mark.parametrize(
    ("index", "code"), [(0x1010, NOT_STORED), (0x1011, NOT_STORED), (0x1005, VALUE), (0x2021, VALUE)]
)
def test_a_wrong_signature_is_told_from_a_wrong_value(in_python: Segment, index: int, code: int) -> None:
    with pytest.raises(SdoAbortedError) as refused:
        check_write(in_python.boards.nodes[0].local, index, 1, 99)
    assert refused.value.code == code


@pytest.mark.parametrize(
    ("cob_id", "code"),
    [
        (0x181, 0),
        (0x4000_0181, 0),  # no remote frames
        (0x182, STATE),  # while it exists, its identifier stays
        (0x8000_0182, 0),
        (0x2000_0181, VALUE),  # 29 bits
        (0x181 | 1 << 28, VALUE),
        (0x800, VALUE),
        (0x000, VALUE),
        (0x080, VALUE),
        (0x001, VALUE),
        (0x07F, VALUE),
        (0x101, VALUE),
        (0x180, VALUE),
        (0x581, VALUE),
        (0x5FF, VALUE),
        (0x601, VALUE),
        (0x67F, VALUE),
        (0x6E0, VALUE),
        (0x701, VALUE),
        (0x77F, VALUE),
        (0x780, VALUE),
        (0x7FF, VALUE),
        (0x8000_0080, 0),  # what is off may have any
    ],
)
def test_a_pdo_takes_identifiers_that_are_free(segment: Segment, link: ArrayLink, cob_id: int, code: int) -> None:
    assert write(segment, link, 0x1800, 1, cob_id, 4) == code


@pytest.mark.parametrize("cob_id", [0x081, 0x100, 0x181, 0x57F, 0x680, 0x6DF])
def test_a_pdo_that_is_off_comes_back_with_any_free_identifier(segment: Segment, link: ArrayLink, cob_id: int) -> None:
    assert write(segment, link, 0x1800, 1, 0x8000_0181, 4) == 0
    assert write(segment, link, 0x1800, 1, cob_id, 4) == 0


@pytest.mark.parametrize(
    ("every", "code"),
    [(0, 0), (1, 0), (240, 0), (241, VALUE), (251, VALUE), (252, VALUE), (253, VALUE), (254, 0), (255, 0)],
)
def test_transmission_types_that_are_reserved_or_remote_are_refused(
    segment: Segment, link: ArrayLink, every: int, code: int
) -> None:
    assert write(segment, link, 0x1800, 2, every, 1) == code


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


@pytest.mark.parametrize("wrong", [0x0000_0100, 0x0080_0064, 0x00FF_0064])
def test_node_ids_that_are_none_are_watched_twice_at_will(segment: Segment, link: ArrayLink, wrong: int) -> None:
    assert write(segment, link, 0x1016, 1, wrong, 4) == 0
    assert write(segment, link, 0x1016, 2, wrong, 4) == 0
    assert write(segment, link, 0x1016, 1, 0x7F_0064, 4) == 0
    assert write(segment, link, 0x1016, 2, 0x7F_0065, 4) == INCOMPATIBLE


def test_the_last_entry_of_watched_nodes_is_looked_at_too(link: ArrayLink, contract: Contract) -> None:
    node = new_segment(contract, link, {1})
    entries = 0
    while write(node, link, 0x1016, entries + 1, (entries + 1) << 16 | 100, 4) == 0:
        entries += 1
    assert entries >= 2
    assert write(node, link, 0x1016, entries + 1, 0, 4) == NO_SUBINDEX
    assert write(node, link, 0x1016, 1, entries << 16 | 200, 4) == INCOMPATIBLE
