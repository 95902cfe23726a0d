"""Stepped boards in C compute and send what the test vectors say, to the last bit."""

import json
import struct
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.link import DISCARDED
from dbc import indices as od
from dbc.board import board
from dbc.board_sums import calibration_values
from dbc.canopen import NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import ECHO, frames
from dbc.patch_filter import IDLE_SAMPLES, SAMPLE_NS, SETTLING_SAMPLES
from nodes.firmware.library import CompiledBoards, Firmware
from nodes.sending import sending_of, vector_files
from nodes.steps.vectors import SINCE_SYNC_NS
from nodes.virtual_boards import VirtualBoards
from skin.layout import changed, load_layout
from tests.bus.harness import frame
from tests.nodes.firmware.stack import compile_adapter
from tests.nodes.firmware.stepped_twins import SKINS, contract_of
from tests.nodes.firmware.twins import needs_compiler
from tests.nodes.helpers import Still

pytestmark = needs_compiler


@cache
def vectors_of(name: str) -> tuple[Contract, dict[str, Any]]:
    contract = contract_of(name)
    text = next(iter(vector_files(contract).values()))
    return contract, json.loads(text)


def sdo(boards: CompiledBoards | VirtualBoards, request: bytes) -> bytes:
    (answer,) = boards.take(frame(SDO_REQUEST_BASE + 1, request.ljust(8, b"\0")), 0.0)
    data: bytes = answer["data"][:8].tobytes()
    return data


def read_real(boards: CompiledBoards, index: int, subindex: int) -> float:
    return float(struct.unpack_from("<f", sdo(boards, struct.pack("<BHB", 0x40, index, subindex)), 4)[0])


def signature_after(boards: CompiledBoards | VirtualBoards, values: dict[tuple[int, int], bytes]) -> int:
    """Write objects of node 1, and read 2009h."""
    for (index, subindex), data in values.items():
        answer = sdo(boards, struct.pack("<BHB", 0x23 | (4 - len(data)) << 2, index, subindex) + data)
        assert answer[0] == 0x60, (index, subindex)
    return int(struct.unpack_from("<I", sdo(boards, struct.pack("<BHB", 0x40, od.CALIBRATION_SIGNATURE, 0)), 4)[0])


@pytest.mark.parametrize("name", ["steps", "fd"])
def test_gains_and_offsets_of_the_vectors_have_their_signature_in_both_languages(name: str) -> None:
    contract = Contract.from_layout(load_layout(Path(name)))
    vectors = json.loads(next(iter(vector_files(contract).values())))
    blocks = range(contract.nodes[0].blocks)
    hardware = sending_of(contract.layout).hardware(contract, blocks, Still(contract), None)
    both = VirtualBoards(contract, 0, {1}, hardware), Firmware(contract, contract.nodes[:1]).boards(0)
    both[0].power_up(0.0)
    if contract.in_steps:
        for counts in vectors["power_up"]["counts"]:
            both[1].take_counts(np.array([counts], np.uint16))
    both[1].power_up(0.0)
    cases = vectors["signatures" if contract.in_steps else "cases"]
    assert len({case["calibration_signature"] for case in cases}) >= 2
    for case in cases:
        shape = len(blocks), contract.phi.block_size
        gain, offset = np.reshape(case["gain"], shape), np.reshape(case["offset_counts"], shape)
        values = calibration_values(np.float32(gain), offset, case.get("pattern", 0))
        found = [signature_after(boards, values) for boards in both]
        assert found == 2 * [case["calibration_signature"]], case.get("name")


@pytest.mark.heavy
@pytest.mark.parametrize("name", SKINS)
def test_samples_become_the_frames_of_the_vectors(name: str) -> None:
    contract, vectors = vectors_of(name)
    size = contract.phi.block_size
    boards = Firmware(contract, contract.nodes[:1]).boards(0)
    idle = vectors["power_up"]["counts"]
    ready = [boards.take_counts(np.array([counts], np.uint16)) for counts in idle]
    assert ready == [False] * (len(idle) - 1) + [True]
    boards.power_up(0.0)
    for index, key in ((od.TAXEL_NOISE, "taxel_noise_n"), (od.COEFFICIENT_NOISE, "coefficient_noise_n")):
        learned = np.array([read_real(boards, index, sub) for sub in range(1, size + 1)], np.float32)
        assert learned.tolist() == np.float32(vectors["power_up"]["settled"][key]).tolist()
    assert read_real(boards, od.NODE_NOISE, 0) == np.float32(vectors["power_up"]["settled"]["board_noise_n"])
    boards.take(frame(NMT_COB_ID, b"\x01\x01"), 0.0)
    held, sent = frames(0), 0
    for number, sample in enumerate(vectors["samples"]):
        if sample["is_asked"]:
            sdo(boards, struct.pack("<BHBB", 0x2F, od.REFRESH, 0, 1))
        if sample["sync"]:
            boards.take(frame(SYNC_COB_ID, bytes((sample["sync"],)), time_ns=number * SAMPLE_NS), 0.0)
        boards.take_counts(np.array([sample["counts"]], np.uint16))
        burst = boards.choose(number * SAMPLE_NS + SINCE_SYNC_NS)
        found = [
            {"cob_id": int(each["can_id"]), "data": each["data"][: each["length"]].tobytes().hex()} for each in burst
        ]
        assert found == sample["frames"], number
        held = np.concatenate([held, burst])
        if sample["bus"] != "held":
            held["flags"] |= DISCARDED if sample["bus"] == "lost" else ECHO
            boards.take(held, 0.0)
            sent += len(held) * (sample["bus"] == "free")
            held = held[:0]
    assert sent > 20


@pytest.mark.heavy
@pytest.mark.parametrize("name", SKINS)
def test_a_board_behind_canopennode_sends_the_frames_of_the_vectors(name: str, tmp_path: Path) -> None:
    contract, vectors = vectors_of(name)
    program = compile_adapter(contract, tmp_path, "run_stepped_canopennode.c")
    idle = [[0, 0, 0, *counts] for counts in vectors["power_up"]["counts"]]
    samples = [
        [("free", "lost", "held").index(each["bus"]), int(each["is_asked"]), each["sync"], *each["counts"]]
        for each in vectors["samples"]
    ]
    lines = "\n".join(" ".join(map(str, each)) for each in idle + samples)
    printed = subprocess.run([program], input=lines, capture_output=True, text=True, check=True).stdout.splitlines()
    signature, noise_bits = map(int, printed[0].split())
    assert signature == board(contract, contract.nodes[0]).signature
    assert struct.unpack("<f", struct.pack("<I", noise_bits))[0] == np.float32(
        vectors["power_up"]["settled"]["board_noise_n"]
    )
    expected = [[f"{each['cob_id']}:{each['data']}" for each in sample["frames"]] for sample in vectors["samples"]]
    assert [line.split() for line in printed[1:]] == expected


@pytest.mark.heavy
def test_a_board_that_sends_at_sync_waits_for_a_late_sync(tmp_path: Path) -> None:
    steps = {"slot_s": 0.004, "at_sync": True, "quiet": 0.0}
    contract = Contract.from_layout(changed(load_layout(Path("steps")), sync={"rate_hz": 250.0}, steps=steps))
    program = compile_adapter(contract, tmp_path, "run_stepped_canopennode.c")
    random, syncs = np.random.default_rng(0), {0: 1, 4: 2, 9: 3, 12: 4, 17: 5}
    counts = random.integers(0, 40, (IDLE_SAMPLES + SETTLING_SAMPLES + 20, contract.phi.block_size)).tolist()
    first = IDLE_SAMPLES + SETTLING_SAMPLES
    lines = [[0, 0, syncs.get(number - first, 0), *each] for number, each in enumerate(counts)]
    text = "\n".join(" ".join(map(str, each)) for each in lines)
    printed = subprocess.run([program], input=text, capture_output=True, text=True, check=True).stdout.splitlines()
    sent = {number: line.split() for number, line in enumerate(printed[1:]) if line}
    assert list(sent) == list(syncs)
    assert [int(each.split(":")[1][:2], 16) for (each,) in sent.values()] == [1, 2, 3, 4, 5]
