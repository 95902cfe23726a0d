"""A layout beside the skins of a hub: names and serial numbers of its own."""

from contextlib import closing
from pathlib import Path

import pytest

from canskin.errors import InputError
from shell import neighbours
from shell.neighbours import new_serial, require_new, tell_shared
from shell.skin_options import join
from skin.layout import Layout, changed, parse_layout, validated
from tests.layouts import layout_toml
from tests.processes import Verb

FIRST = 100
PALM = parse_layout(layout_toml(16, 16, name="palm", device={"first_serial": FIRST}).encode(), "palm.toml")


def of(name: str, first_serial: int) -> Layout:
    return validated(changed(PALM, name=name, device={"first_serial": first_serial}))


def test_a_layout_is_compared_with_the_skins_of_a_hub(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(neighbours, "say", lambda _service, text: told.append(text))
    below, above = FIRST - PALM.blocks, FIRST + PALM.blocks
    with closing(join(PALM, "gateway", endpoint, hub=True)):
        with pytest.raises(InputError, match=r"skin 'palm' is at .* already: give a --out of another name"):
            require_new("palm", endpoint)
        require_new("hand", endpoint)
        for apart in (PALM, of("hand", below), of("hand", above)):
            tell_shared(apart, "contract", endpoint)
        assert not told
        for first_serial in (below + 1, above - 1):
            tell_shared(of("hand", first_serial), "contract", endpoint)
    assert [line.partition(", too")[0] for line in told] == [
        f"serial numbers {first} to {first + PALM.blocks - 1} are those of skin 'palm'"
        for first in (below + 1, above - 1)
    ]
    require_new("palm", endpoint)
    tell_shared(of("hand", FIRST), "contract", endpoint)
    assert len(told) == 2


def test_new_skins_have_serial_numbers_of_their_own(skin: Verb, tmp_path: Path) -> None:
    made = []
    for name in ("palm", "forearm"):
        assert skin("layout", "new", "16x16", "--out", str(tmp_path / f"{name}.toml"))[0] == 0
        made.append(parse_layout((tmp_path / f"{name}.toml").read_bytes(), name))
    assert [each.device.first_serial for each in made] == [new_serial("palm"), new_serial("forearm")]
    assert abs(made[0].device.first_serial - made[1].device.first_serial) > max(each.blocks for each in made)
