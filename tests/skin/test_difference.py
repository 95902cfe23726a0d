"""Two documents, and how they differ."""

import msgspec

from skin.difference import difference
from skin.layout import load_layout

SKIN = load_layout()


def test_the_path_and_both_values_are_named() -> None:
    buses = [msgspec.structs.replace(SKIN.bus[0], bitrate=500_000), *SKIN.bus[1:]]
    other = msgspec.structs.replace(SKIN, bus=buses, taxels=msgspec.structs.replace(SKIN.taxels, untouchable=[3]))
    pair = msgspec.to_builtins(SKIN), msgspec.to_builtins(other)
    assert difference(*pair) == (
        "`$.taxels.untouchable` is not given, there [3]; `$.bus[0].bitrate` is 1000000, there 500000"
    )
    assert not difference(*pair[:1] * 2)


def test_four_are_named_and_the_others_counted() -> None:
    here, there = (dict.fromkeys("abcdef", value) for value in (1, 2))
    told = difference(here, there, "model", "this skin has")
    assert told.startswith("`model.a` is 1, this skin has 2; `model.b`")
    assert told.endswith("`model.d` is 1, this skin has 2; and 2 more")
