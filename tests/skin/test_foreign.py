"""Messages of other devices in a layout."""

from pathlib import Path
from typing import Any

import pytest
import tomli_w

from canskin.errors import LayoutError
from dbc.contract import Contract
from skin.layout import layout_text, load_layout, parse_layout
from tests.descriptions import DBC
from tests.layouts import layout_toml, small_layout


def bus(**keys: Any) -> dict[str, Any]:
    return {"name": "can0", "nodes": 2, **keys}


def message(**keys: Any) -> dict[str, Any]:
    return {"name": "drive", "identifier": 0x185, **keys}


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "cp1252"])
def test_a_dbc_gives_identifiers_lengths_and_periods_and_the_layout_stands_for_itself(
    tmp_path: Path, encoding: str
) -> None:
    (tmp_path / "drives.dbc").write_bytes((DBC + 'CM_ BU_ Drive "größer als 5 µs";\n').encode(encoding))
    own = {"name": "sync", "identifier": 0x0F0, "length": 0, "period_s": 0.004}
    table = bus(foreign_dbc="drives.dbc", foreign=[own])
    (tmp_path / "palm.toml").write_text(tomli_w.dumps({"taxels": {"rows": 8, "columns": 8}, "bus": [table]}))
    layout = load_layout(tmp_path / "palm.toml")
    assert [(each.name, *each.key, each.length, each.period_s) for each in layout.bus[0].foreign] == [
        ("sync", 0x0F0, False, 0, 0.004),
        ("Status", 0x185, False, 6, 0.01),
        ("Far", 0x18FF0102, True, 8, 0.1),
        ("Answer", 0x585, False, 8, None),
        ("Long", 0x18FF0103, True, 8, None),
    ]
    assert [each.name for each in layout.bus[0].foreign if each.is_split] == ["Long"]
    assert parse_layout(layout_text(layout).encode(), "again.toml") == layout


def test_messages_of_two_buses_are_written_and_read(tmp_path: Path) -> None:
    lines = [bus(nodes=1, foreign=[message(), message(name="b", identifier=5)]), bus(name="can1", nodes=1)]
    layout = small_layout(8, 8, bus=[*lines[:1], lines[1] | {"foreign": [message(name="c")]}])
    assert parse_layout(layout_text(layout).encode(), "again.toml") == layout


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ([message(identifier=0x800)], "up to 2047 .7FFh., or `is_extended = true`, got 2048 for 'drive' - at"),
        ([message(identifier=2**29)], "got 536870912 - at"),
        ([message(), message(name="other")], r"'drive' and 'other' have the same identifier 185h - at `\$.bus"),
        ([message(length=9)], "expected a length of 0 to 8, or with `fd = true` of 12, .*, got 9"),
        ([message(fd=True, length=12)], "'drive' is CAN FD: the bus needs `fd = true`"),
        ([message(period_s=0)], "period_s"),
        ([message(identifier=0x80)], "two SYNC producers on can0, 'drive' and the gateway"),
        ([message(identifier=0x182)], "'drive' and TPDO 1 of node 2 have the same identifier 182h on can0"),
        ([message(identifier=0x701)], "'drive' and heartbeat of node 1 have the same identifier 701h"),
        ([message(identifier=0x000)], "'drive' and NMT"),
    ],
)
def test_a_message_that_cannot_be_or_is_the_skins_is_refused_by_name(given: list[dict[str, Any]], says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        Contract.from_layout(small_layout(8, 8, bus=[bus(foreign=given)]))


def test_29_bits_collide_with_nothing_of_the_skin_and_the_same_number() -> None:
    given = [message(identifier=0x181, is_extended=True), message(name="b", identifier=0x081, is_extended=True)]
    assert Contract.from_layout(small_layout(8, 8, bus=[bus(foreign=given)])).nodes


def test_a_clash_names_the_dbc(tmp_path: Path) -> None:
    (tmp_path / "drives.dbc").write_text(DBC)

    def layout(**keys: Any) -> Contract:
        text = tomli_w.dumps({"name": "palm", "taxels": {"rows": 8, "columns": 8}, "bus": [bus(**keys)]})
        return Contract.from_layout(parse_layout(text.encode(), "palm.toml", tmp_path))

    with pytest.raises(
        LayoutError, match=r"palm.toml: 'drive' and 'Status' of drives.dbc, line 5 have the same identifier"
    ):
        layout(foreign_dbc="drives.dbc", foreign=[message()])
    with pytest.raises(LayoutError, match=r"layout palm: 'Status' of drives.dbc, line 5 and TPDO 1 of node 5"):
        layout(foreign_dbc="drives.dbc", nodes=2, first_node_id=5)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        (
            {"foreign": [message(period=1)]},
            r"unknown key `period`: did you mean `period_s`\? - at `\$.bus.0..foreign.0",
        ),
        ({"foreign_dbc": 3}, r"expected text in quotes, got 3 - at `\$.bus.0..foreign_dbc"),
        ({"foreign_dcb": "a.dbc"}, "did you mean `foreign_dbc`"),
        ({"node_ids": []}, "expected 1 entry or more, got 0 - at"),
        ({"optional": [1, 99]}, r"expected node-IDs of the bus, got 99 - at `\$.bus.0..optional`"),
        ({"foreign": [message(), message(identifier=5)]}, "'drive' and 'drive' have the same name"),
    ],
)
def test_a_mistake_in_a_bus_is_told_with_its_remedy(keys: dict[str, Any], says: str) -> None:
    with pytest.raises(LayoutError, match=f"^palm.toml: .*{says}"):
        parse_layout(layout_toml(bus=[{"name": "can0", "nodes": 2} | keys]).encode(), "palm.toml")


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("none.dbc", None),
        ("wrong.dbc", "BO_ x"),
        ("far.dbc, line 5", DBC.replace("389", "3000")),
        ("long.dbc, line 9", DBC.replace("1413 Answer: 8", "1413 Answer: 65")),
        ("slow.dbc, line 5", DBC.replace("BO_ 389 10;", "BO_ 389 90000000;")),
    ],
)
def test_a_dbc_that_cannot_be_read_is_named_with_the_line(name: str, content: str | None, tmp_path: Path) -> None:
    says, name = name, name.split(",", maxsplit=1)[0]
    if content is not None:
        (tmp_path / name).write_text(content)
    table = {"taxels": {"rows": 8, "columns": 8}, "bus": [bus(foreign_dbc=name)]}
    with pytest.raises(LayoutError, match=says):
        parse_layout(tomli_w.dumps(table).encode(), "palm.toml", tmp_path)
