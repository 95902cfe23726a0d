"""A whole skin of 128 nodes on four buses of a real kernel."""

import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from cantools.database import load_file
from cantools.logreader import Parser

from bandwidth.plan import plan
from canskin.messages import GatewayStatus
from dbc.configuration import PROOF_BITS, proof_period_s
from dbc.contract import Contract
from dbc.dictionary import HEARTBEAT_MS
from tests.processes import Processes
from tests.vcan.chain import RATE_HZ, Chain, ip_link, running_chain

#: Looks at the load, of which one has to be without a stall.
LOOKS = 10
#: Bytes of frames that a socket of candump holds: a slow guest does not always let it run in time.
CANDUMP_BUFFER = 32_000_000


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chain]:
    with running_chain(tmp_path_factory.mktemp("chain")) as started:
        yield started


@pytest.fixture(autouse=True)
def _from_a_whole_skin(chain: Chain) -> None:
    chain.await_complete()


def test_measurements_are_complete_and_equal_the_sums_the_nodes_computed(chain: Chain) -> None:
    before = len(chain.measurements)
    known = chain.await_known(30)
    cycles = [each.cycle for each in chain.measurements[before:]]
    assert cycles == list(range(cycles[0], cycles[0] + len(cycles)))
    for measurement in known:
        sums = np.frombuffer(measurement.sums, "<i4")
        assert np.array_equal(sums, chain.true_sums(measurement))
        assert measurement.fingerprint == chain.phi.fingerprint
    assert any(np.frombuffer(each.sums, "<i4").any() for each in known)


def test_what_candump_logs_decodes_to_the_sums_the_nodes_computed(chain: Chain) -> None:
    names = [
        f"Block{block:03}_Row{row:02}" for block, row in zip(chain.phi.block_of_sum, chain.phi.row_of_sum, strict=True)
    ]
    buffer = ("-r", str(CANDUMP_BUFFER))
    with candump(chain.processes, "-L", *buffer, "vcan0", "vcan1", "vcan2", "vcan3") as log:
        known = chain.await_known(25)
        truths = {each.cycle: chain.true_sums(each) for each in known}  # the chain forgets them after a while
        # What waits in candump's sockets is logged before it ends.
        last = f"080#{chain.measurements[-1].sync_counter:02X}"
        chain.processes.until(
            lambda: all(f"vcan{bus} {last}" in end_of(log) for bus in range(4)), "candump's last SYNCs", every_s=0.5
        )
    gathered = sums_in_log(chain, log)
    # candump starts inside a cycle, and measurements of earlier ones may still be on their way.
    logged = [each for each in known if gathered.get(each.sync_counter, {}).keys() == set(names)]
    assert len(logged) >= 20
    for measurement in logged:
        sums = gathered[measurement.sync_counter]
        assert np.array_equal([sums[name] for name in names], truths[measurement.cycle])


def test_load_is_what_canbusload_and_the_plan_say(chain: Chain) -> None:
    """Looks in which the guest stalled say nothing: canbusload takes every interval for a second.

    They are known by the number of frames that canbusload counts; its bits are not looked at for that.
    """
    contract = Contract.from_layout(chain.layout)
    planned = plan(contract)
    for _ in range(LOOKS):
        first = len(chain.statuses)
        measured = list(loads(chain))
        cycles, seconds = (
            chain.statuses[-1].cycles - chain.statuses[first].cycles,
            elapsed(chain.statuses[first:]).sum(),
        )
        counted = [frames for frames, _, _ in measured]
        if cycles / seconds < 0.99 * RATE_HZ or counted != pytest.approx(frames_per_s(contract), rel=0.01):
            continue
        wrong = []
        for number, (_, theirs, ours) in enumerate(measured):
            bus = chain.layout.bus[number]
            proofs = (
                bus.nodes * PROOF_BITS / proof_period_s(contract, number) / bus.bitrate
            )  # SDO, which a plan leaves out
            expected = pytest.approx(theirs, rel=0.02)
            if not (ours == expected and planned[number].load_touched + proofs == expected):
                wrong.append(f"{bus.name}: {theirs} {ours} {planned[number].load_touched} + {proofs}")
        assert not wrong
        return
    pytest.fail(f"the guest kernel did not keep {RATE_HZ} cycles a second in any of {LOOKS} looks")


def elapsed(statuses: list[GatewayStatus]) -> npt.NDArray[np.float64]:
    """Return the seconds between statuses."""
    return np.diff([status.time_ns for status in statuses]) * 1e-9


def frames_per_s(contract: Contract) -> list[float]:
    """Return the frames on each bus: SYNCs and TPDOs, heartbeats, and the two frames of each proof."""
    table = contract.table
    tpdos = np.bincount(table.bus)
    return [
        RATE_HZ * (1 + tpdos[number]) + bus.nodes * (1000 / HEARTBEAT_MS + 2 / proof_period_s(contract, number))
        for number, bus in enumerate(contract.layout.bus)
    ]


def loads(chain: Chain) -> Iterator[tuple[float, float, float]]:
    """Return canbusload's frames a second, and canbusload's and the gateway's load, of every bus over ten seconds."""
    first = len(chain.statuses)
    buses = [f"vcan{number}@{bus.bitrate}" for number, bus in enumerate(chain.layout.bus)]
    chain.processes.start("canbusload", "canbusload", "-e", *buses)
    chain.await_cycles(12 * RATE_HZ)
    chain.processes.stop("canbusload", signal.SIGINT)
    statuses = chain.statuses[first:]
    for number, bus in enumerate(chain.layout.bus):
        said = re.findall(rf"vcan{number}@\d+ +(\d+) +(\d+)", chain.processes.log("canbusload").read_text())
        frames, bits = np.array(said, np.int64)[1:].T
        assert len(bits) > 0
        ours = np.average([status.buses[number].load_ratio for status in statuses[1:]], weights=elapsed(statuses))
        yield float(np.mean(frames)), float(np.mean(bits)) / bus.bitrate, float(ours)


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
    for measurement in chain.await_known(1):
        assert np.array_equal(np.frombuffer(measurement.sums, "<i4"), chain.true_sums(measurement))


def test_strange_frames_are_counted_and_harm_nothing(chain: Chain) -> None:
    before = chain.statuses[-1]
    frames = 300
    # All identifiers a sums' PDO never has, any length, as fast as every second millisecond.
    command = ("cangen", "vcan1", "-n", str(frames), "-g", "2", "-I", "7F0", "-L", "r")
    subprocess.run(command, check=True)
    chain.processes.until(
        lambda: chain.statuses[-1].frames.foreign >= before.frames.foreign + frames, "the strange frames to be counted"
    )
    assert chain.statuses[-1].frames.malformed == before.frames.malformed
    chain.await_complete()
    subprocess.run(["cansend", "vcan1", "181#0102"], check=True)
    chain.processes.until(
        lambda: chain.statuses[-1].frames.malformed == before.frames.malformed + 1, "the short frame to be counted"
    )


@contextmanager
def candump(processes: Processes, *arguments: str) -> Iterator[Path]:
    """Log with candump while the block runs."""
    processes.start("candump", "candump", *arguments)
    processes.until(lambda: processes.log("candump").stat().st_size > 0, "candump's first frames")
    try:
        yield processes.log("candump")
    finally:
        processes.stop("candump", signal.SIGINT)


def end_of(log: Path) -> str:
    """Return the last half megabyte of a log: a few cycles of four buses."""
    with log.open("rb") as lines:
        lines.seek(max(0, log.stat().st_size - 500_000))
        return lines.read().decode("ascii")


def sums_in_log(chain: Chain, log: Path) -> dict[int, dict[str, int]]:
    """Decode a candump log with the skin's DBC files: sums by name, by the SYNC counter of their frames."""
    folder = log.parent / "dbc"
    subprocess.run([sys.executable, "-m", "skin", "contract", str(chain.path), "--out", str(folder)], check=True)
    databases = {f"vcan{number}": load_file(folder / f"{bus.name}.dbc") for number, bus in enumerate(chain.layout.bus)}
    found: dict[int, dict[str, int]] = {}
    with log.open() as lines:
        for frame in Parser(lines):
            message = databases[frame.channel].get_message_by_frame_id(frame.frame_id)
            signals = message.decode(frame.data, decode_choices=False)
            if "TPDO" in message.name:
                found.setdefault(signals.pop("Counter"), {}).update(signals)
    return found


def cansend(channel: str, *frames: str) -> None:
    for each in frames:
        subprocess.run(["cansend", channel, each], check=True)


def await_back(chain: Chain, node: str) -> str:
    """Wait until the gateway's log says that a node is back; return the log."""
    chain.processes.await_words("gateway", f"{node} back after")
    chain.await_complete()
    return chain.processes.log("gateway").read_text()


def test_node_that_a_stray_command_stops_comes_back(chain: Chain) -> None:
    cansend("vcan1", "000#0205")
    assert "node 5 on bus1 left OPERATIONAL: stopped, by another master's NMT command [node-left]" in await_back(
        chain, "node 5 on bus1"
    )
