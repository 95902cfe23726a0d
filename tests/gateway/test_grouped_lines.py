"""Equal lines about several nodes are one line."""

import pytest

from gateway.grouped_lines import GroupedLines


@pytest.fixture
def said() -> list[str]:
    return []


@pytest.fixture
def lines(said: list[str]) -> GroupedLines:
    return GroupedLines("bus3", said.append)


def test_a_line_waits_a_fifth_of_a_second_for_its_equals(lines: GroupedLines, said: list[str]) -> None:
    lines.tick(0.0)
    lines.add(4, "is silent", 0.0)
    lines.add(7, "booted again", 0.125)
    lines.add(5, "is silent", 0.125)
    lines.tick(0.199)
    assert said == []
    lines.tick(0.2)
    assert said == ["nodes 4-5 on bus3 is silent", "node 7 on bus3 booted again"]
    lines.tick(9.0)
    assert len(said) == 2


def test_the_wait_begins_anew_after_the_lines_are_said(lines: GroupedLines, said: list[str]) -> None:
    lines.add(1, "a", 0.0)
    lines.flush()
    assert said == ["node 1 on bus3 a"]
    lines.add(1, "a", 0.5)
    lines.tick(0.6)
    assert len(said) == 1
    lines.tick(0.7001)
    assert said == ["node 1 on bus3 a"] * 2


def test_without_lines_nothing_is_said(lines: GroupedLines, said: list[str]) -> None:
    lines.flush()
    lines.tick(1e9)
    assert said == []
