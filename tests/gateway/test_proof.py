"""What a node's PDOs carry is proven before it counts."""

import struct
from typing import Any

import numpy as np
import pytest

from dbc import indices as od
from dbc.canopen import HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, NmtCommand
from dbc.configuration import calibration, configuration
from dbc.contract import Contract
from dbc.frame import ECHO
from gateway.proof import PART, Known, prove
from gateway.sdo import Read, SdoAbortedError
from tests.layouts import small_contract
from tests.world import PERIOD_S, STEP_S, World, little, swap_mapping, valid

#: Said of gains that differ from those of before; of gains that are those of before, its first part alone.
RECALIBRATED = "node 1 on bus0 gains or offsets (2010h, 2011h) have changed: its zero counts no longer"
DOUBTED = f"{RECALIBRATED}, and its forces are doubtful until 'skin tare'"
GAINS = [(od.GAIN, 1, struct.pack("<f", 0.0)), (od.OFFSET, 5, little(100, 2))]


def deaf_to_writes(world: World, bus: int) -> None:
    """Let the gateway miss what other masters write, as a full receive buffer would."""
    wire = world.wires[bus]
    wire.loses = lambda end, each: bool(
        end is wire.gateway and SDO_REQUEST_BASE < each["can_id"] < 0x680 and not each["flags"] & ECHO
    )


def check(world: World, seconds: float) -> None:
    """Go on, and hold every valid block against the counts of its cycle."""
    for each in world.run(seconds):
        assert not world.wrong_blocks(each)


def test_swapped_mapping_that_was_saved_never_counts(world: World) -> None:
    swap_mapping(world, 0, 1)
    world.write(0, 1, od.STORE, 1, little(od.SIGNATURE_SAVE))
    check(world, STEP_S)
    world.nmt(0, NmtCommand.RESET_NODE, 1)
    check(world, 3.0)
    assert valid(world.measured[-1]).all()
    assert any("set right: 1A00h:2 (TPDO 1 mapping parameter, Mapped object 2) was 2100020Eh" in x for x in world.lines)


def test_swapped_mapping_is_refused_where_the_layout_says_so() -> None:
    world = World(small_contract(configure="refuse"))
    world.until_whole(2.0)
    swap_mapping(world, 0, 1)
    check(world, 3.0)
    assert not valid(world.measured[-1])[0]
    assert valid(world.measured[-1])[1:].all()
    assert world.gateway.masters[0].refused == [1]
    refused = [line for line in world.lines if "refused" in line]
    assert len(refused) == 1
    assert "1A00h:2" in refused[0]
    swap_mapping(world, 0, 1, back=True)
    world.until_whole(1.0)
    assert world.gateway.masters[0].refused == []


@pytest.mark.parametrize("started", [False, True], ids=["doubted", "started by another master"])
def test_refused_node_sends_nothing_under_identifiers_of_another_node(started: bool) -> None:
    """Else its sums would be those of a node that misses a SYNC."""
    world = World(small_contract(configure="refuse"))
    world.until_whole(2.0)
    first, second = world.contract.on_bus(0)
    for place, (tpdo, other) in enumerate(zip(second.tpdos, first.tpdos, strict=True)):
        for cob_id in (tpdo.cob_id | 0xC000_0000, other.cob_id | 0x4000_0000):
            world.write(0, second.node_id, od.TPDO_COMMUNICATION + place, 1, little(cob_id))
    world.run(0.5)
    assert world.gateway.masters[0].refused == [second.node_id]
    if started:
        world.nmt(0, NmtCommand.START, 0)
        world.run(1.5)
    world.nmt(0, NmtCommand.STOP, first.node_id)
    world.wires[0].log.clear()
    check(world, 2 * PERIOD_S)
    taken = {tpdo.cob_id for tpdo in first.tpdos}
    assert not [cob_id for cob_id, _ in world.wires[0].log if cob_id in taken]


#: What somebody writes, and what the gateway says that it has set right.
WRITTEN = {
    "test pattern": ([(od.TEST_PATTERN, 0, b"\2")], "set right: 2021h:0 (Test pattern) was 2h, not 0h"),
    "window": ([(od.WINDOW_US, 0, little(1000))], "set right: 1007h:0"),
    "emergency": ([(od.EMCY_COB_ID, 0, little(0x8000_0081))], "set right: 1014h:0"),
    "transmission type": ([(od.TPDO_COMMUNICATION, 2, b"\2")], "set right: 1800h:2"),
    # 1019h is written while 1006h is 0; what was begun and not ended must not leave 0 there.
    "period": ([(0x1006, 0, little(0))], "set right: 1006h:0"),
    "counter overflow": (
        [(0x1006, 0, little(0)), (od.SYNC_OVERFLOW, 0, b"\x14"), (0x1006, 0, little(50_000))],
        "set right: 1019h:0",
    ),
}


@pytest.mark.parametrize("what", WRITTEN)
def test_what_another_master_writes_is_doubted_at_once_and_set_right(world: World, what: str) -> None:
    writes, said = WRITTEN[what]
    for each in writes:
        world.write(0, 1, *each)
    came = world.run(2 * PERIOD_S)
    assert not valid(came[-1])[0]
    check(world, 2.0)
    assert valid(world.measured[-1]).all()
    assert any(said in line for line in world.lines)
    local = world.segments[0].boards.nodes[0].local
    assert (local.unsigned(od.SYNC_OVERFLOW), local.unsigned(0x1006)) == (240, 50_000)


@pytest.mark.parametrize(
    "change",
    [
        lambda world: swap_mapping(world, 0, 1),
        lambda world: world.write(0, 1, od.TEST_PATTERN, 0, b"\2"),
        lambda world: world.write(0, 1, *GAINS[0]),
    ],
)
def test_a_change_that_nobody_saw_is_found_within_the_stated_time(world: World, change: object) -> None:
    assert callable(change)
    deaf_to_writes(world, 0)
    change(world)
    world.step()
    limit_s = world.gateway.masters[0].proof_limit_s
    assert limit_s < 5.0
    wrong = [bool(world.wrong_blocks(each)) for each in world.run(limit_s)]
    assert any(wrong)  # or there would be nothing to find
    check(world, 2.0)
    assert valid(world.measured[-1]).all()


@pytest.mark.parametrize("written", GAINS, ids=["gain", "offset"])
def test_gains_and_offsets_of_another_master_end_validity_at_once(
    world: World, written: tuple[int, int, bytes]
) -> None:
    world.write(0, 1, *written)
    (first, *_) = came = world.run(2 * PERIOD_S)
    assert not any(valid(each)[0] for each in (first, came[-1]))
    check(world, 1.0)
    assert valid(world.measured[-1]).all()
    assert world.recalibrated == [(0, 1)]
    assert (
        "node 1 on bus0 doubted: another master writes its gains or offsets (2010h, 2011h) [node-changed]"
        in world.lines
    )
    assert DOUBTED in world.lines


@pytest.mark.parametrize("change", ["gains that were not stored", "stored gains that nobody saw"])
def test_gains_that_change_with_a_reset_are_found(world: World, change: str) -> None:
    if change == "stored gains that nobody saw":
        deaf_to_writes(world, 0)
        world.write(0, 1, *GAINS[0])
        world.write(0, 1, od.STORE, 1, little(od.SIGNATURE_SAVE))
    else:
        world.write(0, 1, *GAINS[0])
        check(world, 1.0)
    before = len(world.recalibrated)
    world.nmt(0, NmtCommand.RESET_NODE, 1)
    check(world, 1.0)
    world.until_whole(2.0)
    assert len(world.recalibrated) == before + 1


def test_gains_of_a_board_that_does_not_sign_them_are_read_in_turn(small: Contract) -> None:
    world = World(small)
    other_answers(world, {od.CALIBRATION_SIGNATURE: abort(od.CALIBRATION_SIGNATURE, NO_OBJECT)})
    world.until_whole(3.0)
    master = world.gateway.masters[0]
    assert master.nodes[1].cost == 1 + PART
    aborts = world.wires[0].loses
    assert aborts is not None
    deaf_to_writes(world, 0)
    world.write(0, 1, *GAINS[1])
    world.step()
    world.wires[0].loses = aborts
    until_s = world.now_s + len(master.nodes[1].known.settings) / PART * (1 + PART) * 2.5
    while not world.recalibrated and world.now_s < until_s:
        world.step()
    world.run(2.0)
    assert world.recalibrated == [(0, 1)]
    assert valid(world.measured[-1]).all()
    assert not world.wrong_blocks(world.measured[-1])


def other_answers(world: World, answers: dict[int, bytes]) -> None:
    """Replace answers of node 1 of bus 0 on their way to the gateway, by index of the object."""

    def loses(_end: object, each: np.void) -> bool:
        if each["can_id"] == SDO_RESPONSE_BASE + 1:
            answer = answers.get(int.from_bytes(each["data"][1:3].tobytes(), "little"))
            if answer is not None:
                each["data"][:8] = tuple(answer)
        return False

    world.wires[0].loses = loses


def read_answer(index: int, value: bytes, subindex: int = 0) -> bytes:
    return (
        bytes((0x43 | (4 - len(value)) << 2,))
        + index.to_bytes(2, "little")
        + bytes((subindex,))
        + value.ljust(4, b"\0")
    )


def abort(index: int, code: int, subindex: int = 0) -> bytes:
    return b"\x80" + index.to_bytes(2, "little") + bytes((subindex,)) + little(code)


NO_OBJECT = 0x0602_0000
WRONG_SIGNATURE = read_answer(od.SIGNATURE, little(1))


@pytest.mark.parametrize(
    "answer",
    [read_answer(od.SIGNATURE, little(0)), abort(od.SIGNATURE, NO_OBJECT)],
    ids=["no signature", "no object"],
)
def test_board_without_signature_is_read_object_by_object(small: Contract, answer: bytes) -> None:
    world = World(small)
    other_answers(world, {od.SIGNATURE: answer, od.CALIBRATION_SIGNATURE: abort(od.CALIBRATION_SIGNATURE, NO_OBJECT)})
    world.until_whole(3.0)
    swap_mapping(world, 0, 1)
    check(world, 1.0)
    assert valid(world.measured[-1]).all()
    assert any("set right: 1A00h:2" in line for line in world.lines)
    assert world.gateway.masters[0].nodes[1].cost > 10


@pytest.mark.parametrize(
    ("index", "answer", "words"),
    [
        (od.IDENTITY, read_answer(od.IDENTITY, little(0x1234), 1), "1018h:1 (Identity, Vendor-ID) was 1234h, not 0h"),
        (
            od.PHI_FINGERPRINT,
            read_answer(od.PHI_FINGERPRINT, b"abcd"),
            "2002h:0 (Fingerprint of the measurement operator) was abcd",
        ),
        (od.WINDOW_US, abort(od.WINDOW_US, 0x0609_0011), "object 1007h:0: abort 06090011h, no subindex"),
    ],
)
def test_another_device_is_refused_by_name(small: Contract, index: int, answer: bytes, words: str) -> None:
    world = World(small)
    other_answers(world, {od.SIGNATURE: WRONG_SIGNATURE, index: answer})
    world.run(2.0)
    assert not valid(world.measured[-1])[0]
    assert valid(world.measured[-1])[1:].all()
    refused = [line for line in world.lines if "refused" in line]
    assert len(refused) == 1
    assert words in refused[0]
    assert not [data for can_id, data in world.wires[0].log if can_id == NMT_COB_ID and data == b"\1\1"]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"encoding": {"offset_binary": True}}, "2005h:0 (Encoding"),
        ({"measurement": {"seed": 2}}, "2002h:0 (Fingerprint"),
        ({"taxels": {"frontend": "analogue"}}, "2005h:0 (Encoding"),
    ],
    ids=["encoding", "seed of Φ", "front end"],
)
def test_board_that_was_built_for_another_skin_is_refused_until_it_is_replaced(
    small: Contract, changed: dict[str, Any], words: str
) -> None:
    other = small_contract(**changed)
    world = World(small, built=other)
    world.segments[1] = world.new_segment(1, small)
    world.segments[1].boot(world.now_s)
    world.run(2.0)
    assert [valid(each).tolist() for each in world.measured[-5:]] == [[False, False, True, True]] * 5
    assert len(world.lines) == 1
    assert world.lines[0].startswith(f"nodes 1-2 on bus0 refused: {words}")
    assert world.status().buses[0].refused == [1, 2]
    world.wires[0].log.clear()
    world.pass_time(5.0)
    assert not [can_id for can_id, _ in world.wires[0].log if SDO_REQUEST_BASE < can_id < HEARTBEAT_BASE]
    world.segments[0] = world.new_segment(0, small)
    world.segments[0].boot(world.now_s)
    world.carry(world.hear)
    assert world.status().buses[0].refused == []
    world.until_whole(1.0)


def test_wrong_signature_of_right_objects_is_refused(small: Contract) -> None:
    """What the electronics do may differ from what the dictionary says."""
    world = World(small)
    other_answers(world, {od.SIGNATURE: WRONG_SIGNATURE})
    world.run(2.0)
    assert not valid(world.measured[-1])[0]
    assert (
        "node 1 on bus0 refused: its objects are right, but not their signature (2006h) [node-refused]" in world.lines
    )


def test_a_node_that_aborts_a_read_is_doubted_and_refused(small: Contract) -> None:
    node, doubts = small.nodes[0], []
    known = Known(calibration(small, node))
    steps = prove(configuration(small, node), 0x1234, known, write=True, in_use=True, doubt=doubts.append)
    assert next(steps) == Read(od.CALIBRATION_SIGNATURE, 0, od.UNSIGNED32)
    assert steps.send(little(7)) == Read(od.SIGNATURE, 0, od.UNSIGNED32)
    read = steps.send(little(0))  # it computes no signature
    assert not doubts
    with pytest.raises(StopIteration) as ended:
        steps.throw(SdoAbortedError(read, 0x0800_0020))
    assert doubts == ["doubted: its configuration is not that of the layout"]
    assert "abort 08000020h" in ended.value.value.refusal


def test_another_device_is_named_as_such_though_it_has_no_other_object() -> None:
    contract = small_contract()
    settings = configuration(contract, contract.nodes[0])
    steps = prove(settings, 0, Known(()), write=True, in_use=False, doubt=lambda _: None)
    transfer, proof = next(steps), None
    while proof is None:
        try:
            is_there = transfer.index == od.IDENTITY
            transfer = steps.send(little(7)) if is_there else steps.throw(SdoAbortedError(transfer, 0x0602_0000))
        except StopIteration as end:
            proof = end.value
    assert proof.is_other_device
    assert "1018h:1" in proof.refusal


def test_a_board_of_another_bus_is_named_where_it_belongs() -> None:
    """So it is where two interfaces are swapped."""
    contract = small_contract()
    (mine, *_), (other, *_) = contract.on_bus(0), contract.on_bus(1)
    values = {(each.index, each.subindex): each.data for each in configuration(contract, other)}
    steps = prove(configuration(contract, mine), 0, Known(()), write=True, in_use=False, doubt=lambda _: None)
    transfer, proof = next(steps), None
    while proof is None:
        try:
            transfer = steps.send(values.get((transfer.index, transfer.subindex), little(5)))
        except StopIteration as end:
            proof = end.value
    assert proof.told(contract).startswith(
        "it is the board of bus1 node 1: are interfaces or boards swapped? 2000h:0 ("
    )
    assert not proof.is_other_device
