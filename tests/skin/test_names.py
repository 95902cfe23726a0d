"""Lists of names on the command line."""

import pytest

from skin.sources import split_names


@pytest.mark.parametrize("given", [["cup,ring"], ["cup", "ring"], ["cup, ring,", "cup"]])
def test_names_with_spaces_or_commas_count_once(given: list[str]) -> None:
    assert split_names(given) == ("cup", "ring")
    assert split_names([]) == ()
