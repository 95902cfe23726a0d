"""A whole skin of 128 nodes on four buses of a real kernel."""

import re
import signal
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from dbc.contract import SYNC_COB_ID, contract, phase_of
from skin.messages import GatewayStatus
from tests.processes import Processes
from tests.vcan.chain import RATE_HZ, Chain, complete, ip_link, running_chain


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chain]:
    with running_chain(tmp_path_factory.mktemp("chain")) as started:
        yield started


@pytest.fixture(autouse=True)
def _from_a_whole_skin(chain: Chain) -> None:
    chain.await_complete()


def balance(status: GatewayStatus) -> int:
    used = status.frames_accepted + status.frames_late + status.frames_duplicate + status.frames_malformed
    return status.frames_received - used


def test_measurements_are_complete_and_equal_the_sums_the_nodes_computed(chain: Chain) -> None:
    measured = chain.await_cycles(30)
    assert sum(map(complete, measured)) >= 28  # the guest may be held up once
    assert [each.cycle for each in measured] == list(range(measured[0].cycle, measured[0].cycle + 30))
    for measurement in filter(complete, measured):
        sums = np.frombuffer(measurement.sums, "<i4")
        assert np.array_equal(sums, chain.true_sums(measurement))
        assert measurement.fingerprint == chain.phi.fingerprint
    assert any(np.frombuffer(each.sums, "<i4").any() for each in measured)


def test_what_candump_logs_decodes_to_the_sums_the_nodes_computed(chain: Chain) -> None:
    with candump(chain.processes, "-L", "vcan0", "vcan1", "vcan2", "vcan3") as log:
        measured = chain.await_cycles(20)
    gathered = sums_in_log(chain, log.read_text())
    inside = [each for each in filter(complete, measured) if each.sync_counter in gathered][1:-1]
    assert len(inside) >= 15
    for measurement in inside:
        sums = gathered[measurement.sync_counter]
        assert len(sums) == chain.phi.shape[0]
        assert np.array_equal([sums[place] for place in range(len(sums))], chain.true_sums(measurement))


def test_load_is_what_canbusload_says(chain: Chain) -> None:
    first = len(chain.statuses)
    buses = [f"vcan{number}@{bus.bitrate}" for number, bus in enumerate(chain.layout.bus)]
    chain.processes.start("canbusload", "canbusload", "-e", *buses)
    chain.await_cycles(12 * RATE_HZ)
    chain.processes.stop("canbusload", signal.SIGINT)
    statuses = chain.statuses[first:]
    elapsed_s = np.diff([status.time_ns for status in statuses]) * 1e-9
    for number, bus in enumerate(chain.layout.bus):
        said = re.findall(rf"vcan{number}@\d+ +(\d+) +(\d+)", chain.processes.log("canbusload").read_text())
        bits = [int(bits) for _, bits in said][1:]
        assert len(bits) >= 9
        theirs = np.mean(bits) / bus.bitrate
        ours = np.average([status.buses[number].load_ratio for status in statuses[1:]], weights=elapsed_s)
        print(bus.name, theirs, ours, ours / theirs, len(bits))
        assert ours == pytest.approx(theirs, rel=0.02)


@pytest.mark.parametrize(
    ("away", "back"),
    [
        ([["set", "vcan2", "down"]], [["set", "vcan2", "up"]]),
        ([["del", "vcan2"]], [["add", "vcan2", "type", "vcan"], ["set", "vcan2", "mtu", "72", "up"]]),
    ],
    ids=["down", "deleted"],
)
def test_an_interface_that_goes_takes_only_its_own_blocks_and_comes_back(
    chain: Chain, away: list[list[str]], back: list[list[str]]
) -> None:
    before = len(chain.measurements)
    for step in away:
        ip_link(*step)
    chain.await_valid(~chain.blocks_of(2))
    for step in back:
        ip_link(*step)
    chain.await_complete()
    cycles = [each.cycle for each in chain.measurements[before:]]
    assert cycles == list(range(cycles[0], cycles[0] + len(cycles)))
    measurement = next(each for each in reversed(chain.measurements) if complete(each))
    assert np.array_equal(np.frombuffer(measurement.sums, "<i4"), chain.true_sums(measurement))
    assert balance(chain.statuses[-1]) == 0


def test_strange_frames_are_counted_and_harm_nothing(chain: Chain) -> None:
    before = chain.statuses[-1]
    frames = 300
    # All identifiers a sums' PDO never has, any length, as fast as every second millisecond.
    command = ("cangen", "vcan1", "-n", str(frames), "-g", "2", "-I", "7F0", "-L", "r")
    subprocess.run(command, check=True)
    chain.processes.until(
        lambda: chain.statuses[-1].frames_foreign >= before.frames_foreign + frames, "the strange frames to be counted"
    )
    assert chain.statuses[-1].frames_malformed == before.frames_malformed
    chain.await_complete()
    subprocess.run(["cansend", "vcan1", "181#0102"], check=True)
    chain.processes.until(
        lambda: chain.statuses[-1].frames_malformed == before.frames_malformed + 1, "the short frame to be counted"
    )
    assert balance(chain.statuses[-1]) == 0


@contextmanager
def candump(processes: Processes, *arguments: str) -> Iterator[Path]:
    """Log with candump while the block runs."""
    processes.start("candump", "candump", *arguments)
    processes.until(lambda: processes.log("candump").stat().st_size > 0, "candump's first frames")
    try:
        yield processes.log("candump")
    finally:
        processes.stop("candump", signal.SIGINT)


def sums_in_log(chain: Chain, text: str) -> dict[int, dict[int, int]]:
    """Read a candump log by the contract: sums by number, by counter of the SYNC before them on their bus."""
    made = contract(chain.layout)
    tpdos = {(f"vcan{node.bus}", tpdo.cob_id): tpdo for node in made.nodes for tpdo in node.tpdos}
    counter: dict[str, int] = {}
    found: dict[int, dict[int, int]] = {}
    for bus, identifier, data in re.findall(r"^\(\d+\.\d+\) (\w+) ([0-9A-F]{3})#([0-9A-F]*)$", text, re.MULTILINE):
        payload = bytes.fromhex(data)
        if int(identifier, 16) == SYNC_COB_ID:
            counter[bus] = payload[0]
        elif (bus, int(identifier, 16)) in tpdos and bus in counter:
            tpdo = tpdos[bus, int(identifier, 16)]
            assert tpdo.phase == phase_of(counter[bus])
            for place, (value,) in enumerate(struct.iter_unpack("<h", payload)):
                found.setdefault(counter[bus], {})[tpdo.first_sum + place] = value
    return found
