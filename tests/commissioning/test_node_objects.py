"""Objects of a node by name: found in the EDS, read and written while a gateway runs."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from canskin.errors import InputError, RunError
from commissioning.node_objects import Entry, NodeTransfers, entries_of_file, entries_of_node, find, parse_writes
from dbc import indices as od
from dbc.eds import eds, node_types
from dbc.frame import Frames
from dbc.objects import Object
from nodes.objects import LocalNode, Outbox, object_dictionary
from tests.bus.harness import frame
from tests.layouts import small_contract
from tests.world import World

CONTRACT = small_contract()
NODE = CONTRACT.nodes[1]
ENTRIES = entries_of_node(CONTRACT, NODE)


def transfers(world: World, reads: Sequence[Entry], writes: Sequence[tuple[Entry, bytes]] = ()) -> NodeTransfers:
    """Carry out transfers with `NODE` on its bus."""
    wire = world.wires[NODE.bus]

    def send(burst: Frames) -> int:
        wire.put(int(burst["can_id"][0]), burst["data"][0, : burst["length"][0]].tobytes())
        return 1

    talk, read = NodeTransfers(NODE.node_id, reads, send, world.now_s, writes), len(wire.log)
    for _ in range(400):
        world.step()
        for can_id, data in wire.log[read:]:
            talk.take(frame(can_id, data), world.now_s)
        read = len(wire.log)
        if talk.done:
            return talk
        talk.tick(world.now_s)
    raise AssertionError("the transfers do not end")


@pytest.mark.parametrize(
    ("text", "places"),
    [
        ("Producer heartbeat time", ["1017h:0"]),
        ("producer HEARTBEAT time", ["1017h:0"]),
        ("1017", ["1017h:0"]),
        ("0x1018:4", ["1018h:4"]),
        ("1018h", ["1018h:0", "1018h:1", "1018h:2", "1018h:3", "1018h:4"]),
        ("vendor-id", ["1018h:1"]),
        ("Health.SYNC messages seen", ["2020h:1"]),
    ],
)
def test_an_object_is_found_by_name_and_by_number(text: str, places: list[str]) -> None:
    assert [each.place for each in find(ENTRIES, text)] == places


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("Producer heartbeat tim", "near are Producer heartbeat time"),
        ("7000h", "expected an object of the device, by name or index:sub, got '7000h'"),
        ("1018h:9", "got '1018h:9'"),
        ("SYNC start value", "expected one of them"),
    ],
)
def test_what_names_no_object_or_several_is_refused(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        find(ENTRIES, text)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1017h", "expected OBJECT=VALUE"),
        ("1018h=3", "expected OBJECT=VALUE with one object"),
        ("1017h=fast", "expected a value of UNSIGNED16, got 'fast'"),
        ("1017h=h", "expected a value of UNSIGNED16, got 'h'"),
        ("1017h=65536", "65536"),
        ("1017h=-1", "-1"),
    ],
)
def test_a_value_that_the_type_does_not_have_is_refused(text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        parse_writes(ENTRIES, [text])


def test_values_have_types_and_units_and_text_and_errors_words() -> None:
    world = World(CONTRACT)
    world.until_whole(10.0)
    (beat,), (name,), (serial,) = (find(ENTRIES, each) for each in ("1017h", "1008h", "1018h:4"))
    absent = Entry(0x2FFF, 0, "absent", beat.variable)
    values = transfers(world, [beat, name, absent, serial]).values
    assert (beat.type_name, beat.unit, beat.decode(values[beat])) == ("UNSIGNED16", "ms", 1000)
    assert isinstance(name.decode(values[name]), str)
    assert serial.decode(values[serial]) == 1 + NODE.block
    assert values[absent] == "object 2FFFh:0: abort 06020000h, no object"


def test_a_written_object_is_read_back_and_the_gateway_sets_it_right_again() -> None:
    world = World(CONTRACT)
    world.until_whole(10.0)
    writes = parse_writes(ENTRIES, ["Producer heartbeat time=500"])
    (entry,) = (each for each, _ in writes)
    assert entry.decode(transfers(world, [entry], writes).values[entry]) == 500
    world.until_whole(10.0)
    assert entry.decode(transfers(world, [entry]).values[entry]) == 1000
    assert all(not world.wrong_blocks(each) for each in world.measured)


def test_a_write_that_the_node_refuses_is_told_in_words_with_what_was_written() -> None:
    world = World(CONTRACT)
    ((heartbeat, data),) = parse_writes(ENTRIES, ["1017h=1F4h"])
    (vendor,) = find(ENTRIES, "1018h:1")
    refused = r"Identity\.Vendor-ID is not written: .* abort 06010002h, read only"
    with pytest.raises(RunError, match=f"{refused}$"):
        transfers(world, [], [(vendor, data)])
    with pytest.raises(RunError, match=f"{refused}; written before: Producer heartbeat time$"):
        transfers(world, [], [(heartbeat, data), (vendor, data)])


def test_a_write_to_what_is_known_as_read_only_is_refused_before_the_first() -> None:
    with pytest.raises(InputError, match=r"Vendor-ID .1018h:1. cannot be written, its access is"):
        parse_writes(ENTRIES, ["1017h=500", "1018h:1=5"])


def test_a_value_of_more_than_four_bytes_is_written_and_read_in_segments() -> None:
    device = LocalNode(5, object_dictionary([Object(0x3000, None, "Name", od.VISIBLE_STRING, "rw", "unnamed")]), 16, 8)
    outbox = Outbox()
    outbox[5] = device
    entry = Entry(0x3000, 0, "Name", device.object_dictionary[0x3000])

    def send(burst: Frames) -> int:
        outbox.notify(int(burst["can_id"][0]), bytearray(burst["data"][0, :8]), 0.0)
        return 1

    talk = NodeTransfers(5, [entry], send, 0.0, parse_writes([entry], ["Name=left forearm"]))
    for _ in range(10):
        talk.take(outbox.take(), 0.0)
    assert talk.done
    assert talk.values == {entry: b"left forearm"}


def test_the_eds_of_a_device_gives_the_same_objects(tmp_path: Path) -> None:
    (kind, *_) = node_types(CONTRACT)
    (tmp_path / "drive.eds").write_text(eds(CONTRACT, kind))
    assert entries_of_file(tmp_path / "drive.eds", NODE.node_id) == ENTRIES


@pytest.mark.parametrize("content", [None, "[1000]\nParameterName=x\n", "nothing", "", "\x00\xff"])
def test_a_file_that_is_no_eds_is_refused(content: str | None, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / "drive.eds").write_text(content)
    with pytest.raises(InputError, match=r"drive\.eds") as told:
        entries_of_file(tmp_path / "drive.eds", 5)
    assert "\n" not in str(told.value)
    assert "ff" not in str(told.value)
