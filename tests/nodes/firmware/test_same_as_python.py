"""The C boards send what the Python nodes send, bit for bit: sums, packing, dictionary, NMT, heartbeats."""

import os
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from dbc import indices as od
from dbc.canopen import NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID, NmtCommand
from dbc.codec import decode
from dbc.contract import Contract, NodeContract
from dbc.dictionary import dictionary
from nodes.electronics import Calibration
from nodes.firmware.library import CompiledBoards, Firmware
from skin.layout import SUM_BITS_MAX, SUM_BITS_MIN, Encoding, Sampling, changed, load_layout
from tests.bus.harness import frame
from tests.layouts import buses
from tests.nodes.firmware.twins import Twins, analogue, few_sums, needs_compiler, small_contract
from tests.nodes.helpers import read_request

pytestmark = needs_compiler

#: Frames of taxels that are compared: a million on request.
CYCLES = int(os.environ.get("SKIN_FIRMWARE_CYCLES", "2000"))
#: Frames of taxels with the same gains and offsets.
BATCH = 500


def eight_bits() -> Contract:
    default = load_layout(Path("default"))
    return Contract.from_layout(changed(default, encoding=Encoding(sum_bits=8), sampling=Sampling()))


TWO_BLOCKS = buses(1, 1, blocks_per_node=2)
CONTRACTS = {
    "14 bits": small_contract,
    "in turns": lambda: small_contract(turns=2),
    "empty places": lambda: small_contract(taxels={"rows": 7, "columns": 17}),
    "positions, unequal boards": lambda: Contract.from_layout(load_layout(Path("forearm"))),
    "one bit": lambda: small_contract(taxels={"adc_bits": 1}),
    "12 bits, offset binary": lambda: small_contract(encoding={"sum_bits": 12, "offset_binary": True}, bus=TWO_BLOCKS),
    "uniform": lambda: small_contract(measurement={"selection": "uniform", "seed": 4}),
    "fewer sums than blocks": lambda: few_sums(buses(2, 2)),
    "fewer sums than blocks, nodes of two, in turns": lambda: few_sums(TWO_BLOCKS, turns=2),
    "8 bits, default skin": eight_bits,
    "analogue": analogue,
    "analogue, 8 of 16 bits, nodes of two": lambda: analogue(8, 16, bus=TWO_BLOCKS),
    "analogue, more bits than codes, fewer sums than blocks": lambda: analogue(16, 6, measurement={"sums": 3}),
}


@pytest.mark.heavy
@pytest.mark.parametrize("name", CONTRACTS)
def test_sums_and_frames_at_every_sync(name: str) -> None:
    check_syncs(Twins(CONTRACTS[name]()))


@pytest.mark.heavy
@pytest.mark.parametrize("bits", range(SUM_BITS_MIN, SUM_BITS_MAX + 1))
def test_sums_of_every_width_on_classic_can_and_can_fd(bits: int) -> None:
    """Numbers of sums that fill frames and that do not, two blocks a board, in one cycle or in turns."""
    random = np.random.default_rng(bits)
    contract = small_contract(
        turns=1 + bits % 2,
        measurement={"sums": int(random.integers(5, 129)), "selection": "uniform"},
        encoding={"sum_bits": bits, "offset_binary": bits % 3 == 0},
        bus=[*buses(1, blocks_per_node=2), *buses(1, names=["fast"], blocks_per_node=2, fd=True)],
    )
    for bus in range(2):
        check_syncs(Twins(contract, bus))


def check_syncs(twins: Twins) -> None:
    """Compare what both send at 60 SYNCs; where boards do not average, some are lost, and some have no counter."""
    twins.nmt(NmtCommand.START)
    twins.answers()
    random = np.random.default_rng(3)
    is_averaged = twins.contract.layout.samples_per_sync > 1
    pdo_ids = np.flatnonzero(twins.c.is_pdo)
    counter, sent = 200, 0  # 240 and 1 come, too
    for _ in range(60):
        twins.now_s += 0.01
        counter = counter % 240 + (1 if is_averaged else int(random.integers(1, 3)))
        counter = counter if counter <= 240 else 1
        told = counter if is_averaged or random.random() < 0.9 else 0
        twins.sync(told)
        answers = twins.answers()
        answers = answers[np.isin(answers["can_id"], pdo_ids)]
        assert {*answers["data"][:, 0].tolist()} <= {told}
        sent += len(answers)
    for node in twins.nodes:
        assert read_counts(twins, node) or twins.contract.layout.taxels.is_analogue  # without 2012h
    assert sent > 20


def read_counts(twins: Twins, node: NodeContract) -> list[int]:
    """Return the counts of a node that are not 0; both tell the same."""
    for place in range(node.blocks):
        for subindex in range(1, twins.contract.phi.block_size + 1):
            twins.put(SDO_REQUEST_BASE + node.node_id, read_request(od.of_block(od.COUNTS, place), subindex))
    counts = twins.answers()["data"][:, 4:6].copy().view("<u2").ravel()
    return counts[counts > 0].tolist()  # type: ignore[no-any-return]


#: Gains at the ends of what REAL32 holds, and products that fall between two counts.
EXTREMES = np.array([0, -0.0, 1, -1, 3e38, -3e38, 1e-45, 0.5, 1023.5, 1 / 3], np.float32)


def test_many_random_taxels_with_gains_and_offsets() -> None:
    contract = small_contract(encoding={"sum_bits": 16})  # exact
    boards, table = Firmware(contract, contract.nodes).boards(0), contract.table
    boards.power_up(0.0)
    boards.take(frame(NMT_COB_ID, b"\x01\x00"), 0.0)
    random, sent = np.random.default_rng(11), np.zeros(contract.phi.shape[0], np.int32)
    calibration = Calibration(contract.layout.taxels)
    sync = frame(SYNC_COB_ID, b"\x01")
    for batch in range(0, CYCLES, BATCH):
        if batch:  # the first with the defaults
            calibrate(boards, calibration, contract.phi.order[:64], random)
        counts = random.integers(0, 1024, (min(BATCH, CYCLES - batch), 128)).astype(np.uint16)
        with np.errstate(over="ignore"):
            corrected = counts.astype(np.float32) * calibration.gain + calibration.offset
        corrected = np.rint(np.clip(corrected, 0, 1023)).astype(np.int32)
        for row, sums in zip(counts, contract.phi.forward(corrected)[:, :16], strict=True):
            answer = boards.answer(sync, 0.0, row[None])
            decode(answer["data"], table.gather[table.row_of[0, answer["can_id"]]], contract.packing, sent)
            assert np.array_equal(sent[:16], sums)


def calibrate(
    boards: CompiledBoards, calibration: Calibration, taxels: npt.NDArray[np.intp], random: np.random.Generator
) -> None:
    """Write random gains and offsets of two boards over SDO, and to `calibration`."""
    for row, taxel in enumerate(taxels):
        node, place = divmod(row, 32)
        gain = random.choice(EXTREMES) if row % 2 else np.float32(random.normal(1, 0.2))
        offset = int(random.choice([-32768, 32767, 0])) if row % 8 == 0 else int(random.integers(-40, 40))
        calibration.gain[taxel], calibration.offset[taxel] = gain, offset
        for command, data in (
            (b"\x23\x10\x20", gain.tobytes()),
            (b"\x2b\x11\x20", offset.to_bytes(2, "little", signed=True) + bytes(2)),
        ):
            answer = boards.take(frame(SDO_REQUEST_BASE + 1 + node, command + bytes((place + 1,)) + data), 0.0)
            assert answer["data"][:, 0].tolist() == [0x60]


#: SDO commands: uploads, downloads of every size, segments, an abort.
COMMANDS = (0x40, 0x40, 0x23, 0x27, 0x2B, 0x2F, 0x22, 0x21, 0x20, 0x60, 0x70, 0x00, 0x11, 0x0D, 0x80)
VALUES = (0, 1, 2, 3, 254, 0x80, 0x1000, od.SIGNATURE_SAVE, od.SIGNATURE_LOAD, 0x80000180, 0x40000181)


def random_request(random: np.random.Generator, indices: list[tuple[int, int]]) -> bytes:
    """Return an SDO request: most of them of an object that there is."""
    index, subindex = indices[random.integers(len(indices))]
    if random.random() < 0.1:
        index, subindex = int(random.integers(0x10000)), int(random.integers(256))
    command = int(random.choice(COMMANDS))
    if random.random() < 0.05:
        command = int(random.integers(256))
    value = int(random.choice(VALUES))
    if random.random() < 0.2:
        value = int(random.integers(1 << 32))
    if od.TPDO_COMMUNICATION <= index < od.TPDO_MAPPING and subindex == 2:
        # Types above 1 count SYNCs: from which one on is free.
        value = int(random.choice((0, 1, 241, 253, 254)))
    return bytes((command, index & 0xFF, index >> 8, subindex)) + value.to_bytes(4, "little")


@pytest.mark.heavy
@pytest.mark.parametrize("seed", range(6))
def test_random_requests_get_the_same_answers(seed: int) -> None:
    asked = ("in turns", "14 bits", "in turns", "14 bits", "fewer sums than blocks", "analogue")
    contract = CONTRACTS[asked[seed]]()
    twins = Twins(contract)
    twins.answers()
    of_both = [each for each in dictionary(contract, contract.nodes[0]) if not od.is_program_download(each.index)]
    indices = [(each.index, each.subindex or 0) for each in of_both]
    random = np.random.default_rng(seed)
    counter = 0
    for turn in range(1500):
        twins.put(SDO_REQUEST_BASE + 1 + int(random.integers(2)), random_request(random, indices))
        if turn % 50 == 0:
            twins.put(NMT_COB_ID, bytes((int(random.choice([1, 1, 1, 2, 128, 129, 130])), int(random.integers(3)))))
        if turn % 10 == 0:
            twins.now_s += 0.01
            counter = counter % 240 + 1
            twins.sync(counter)
        twins.answers()


def test_event_driven_pdos_keep_timer_and_inhibit_time() -> None:
    twins = Twins(small_contract())
    twins.nmt(NmtCommand.START)
    twins.sync(1)
    for subindex, value, size in ((1, 0xC0000181, 4), (2, 254, 1), (3, 500, 2), (5, 200, 2), (1, 0x40000181, 4)):
        twins.write(0x1800, subindex, value.to_bytes(size, "little"))
    twins.answers()
    twins.go_on(1.0, 0.007)  # no multiple of the times
    assert 4 <= np.count_nonzero(twins.answers()["can_id"] == 0x181) <= 6
    twins.sync(2)  # new sums
    twins.go_on(0.15, 0.007)
    assert 0x181 in twins.answers()["can_id"]


def test_boards_with_thermometers_answer_unknown_until_their_maker_reads_one() -> None:
    """The temperature of Python nodes is simulated."""
    twins = Twins(small_contract(taxels={"has_thermometers": True}))
    twins.put(0x601, read_request(od.TEMPERATURE))
    python, c = (link.take_sent()["data"][-1, :6].tobytes() for link in twins.links)
    assert (python, c) == (b"\x4b\x36\x20\0\xa6\x0b", b"\x4b\x36\x20\0\xff\x7f")
