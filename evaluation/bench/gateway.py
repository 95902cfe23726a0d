"""``skin bench gateway``: frames per second of one core, from the socket to a complete measurement, against peers.

Each bus is a pair of datagram sockets that carries ``struct can_frame``, as a socket of CAN does, with the kernel's
time stamps. Each peer reads them with the code that it reads a SocketCAN interface with, and works in its ordinary way:
a thread per bus. The peers gather sums and nothing else; ours also judges every frame and counts the load.
"""

import io
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from select import select
from typing import Any, Final, Protocol

import can
import canopen
import numpy as np
import numpy.typing as npt
from can.interfaces.socketcan import SocketcanBus
from canopen.objectdictionary.eds import import_eds

from bus.interface import FD_BYTES
from bus.recvmmsg import SO_RXQ_OVFL, SO_TIMESTAMPNS, BatchSocket
from bus.socketcan import BATCH_FRAMES, RECEIVE_BUFFER_BYTES, SocketCanLink, encode
from canskin.errors import RunError
from dbc import codec
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.eds import dcfs, node_types
from dbc.frame import ECHO, Frames
from dbc.packing import COUNTER_BYTES
from evaluation.result import Row
from gateway.gathering import Sync
from gateway.loop import GatewayLoop
from skin.layout import load_layout
from skin.sync_counter import next_counter

#: Frames that wait on each bus when the reader wakes.
WAKE_UPS: Final = (1, 8, 64)
#: Cycles of a round; before the first round, as many run and do not count.
CYCLES: Final = 5
#: Longest wait for the threads of a peer to take what was sent.
_PATIENCE_S: Final = 10.0
#: Pause between two looks at whether they have.
_LOOK_S: Final = 2e-4
Integers = npt.NDArray[np.int64]


class _Method(Protocol):
    """One way to make measurements of what the sockets carry."""

    def begin(self) -> None:
        """Begin a cycle, before its SYNC is sent."""

    def wake(self, sent: int) -> None:
        """Take what waits; `sent` frames have been sent since the cycle began."""

    def end(self) -> Integers:
        """Return the sums of the cycle."""
        ...

    @property
    def used_s(self) -> float:
        """Processor time so far, seconds."""
        ...


def run(rounds: int) -> dict[str, Any]:
    """Return ``{"rows": […]}``: frames per second of one core for each number of frames a wake-up, and our ratio."""
    contract = Contract.from_layout(load_layout())
    return {"rows": [_row(contract, frames, rounds) for frames in WAKE_UPS]}


def _row(contract: Contract, frames: int, rounds: int) -> Row:
    methods: dict[str, Callable[..., AbstractContextManager[_Method]]] = {
        "canskin": _ours,
        "python-can": _python_can,
        "canopen": _canopen,
    }
    used_us = {name: _used_us(contract, method, frames, rounds) for name, method in methods.items()}
    per_s = {f"{name}, frames/s": round(1e6 / each) for name, each in used_us.items()}
    ratios = {f"ours / {name}": each / used_us["canskin"] for name, each in used_us.items() if name != "canskin"}
    return {"frames a wake-up": frames, **per_s, **ratios}


def _used_us(
    contract: Contract, make: Callable[..., AbstractContextManager[_Method]], frames: int, rounds: int
) -> float:
    """Return the processor time of a frame in microseconds: the median of the rounds."""
    buses, random = range(len(contract.layout.bus)), np.random.default_rng(1)
    low, high = contract.packing.raw_range
    with ExitStack() as opened:
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in buses]
        for each in (one for pair in pairs for one in pair):
            opened.enter_context(each)
        method = opened.enter_context(make(contract, [near for near, _ in pairs]))
        senders = [_sender(far) for _, far in pairs]
        counter, taken_us, sums = 0, [], np.zeros(contract.phi.shape[0], np.int32)
        for number in range(rounds + 1):
            since_s, count = method.used_s, 0
            for _ in range(CYCLES):
                method.begin()
                counter = next_counter(counter)
                came = contract.sums_of_turn[contract.turn_of(counter)]
                sums[came] = contract.packing.counts(random.integers(low, high + 1, came.size, np.int32))
                wires = [_wire(contract, bus, counter, sums) for bus in buses]
                count += sum(len(lengths) for _, lengths in wires)
                for begin in range(0, max(len(lengths) for _, lengths in wires), frames):
                    for sender, (rows, lengths) in zip(senders, wires, strict=True):
                        sender.send(rows[begin : begin + frames], lengths[begin : begin + frames])
                    method.wake(begin + frames)
                # A block counts once all its sums have come.
                if not np.array_equal(method.end(), sums) and number:
                    raise RunError("expected the sums that were sent, got others")
            taken_us.append(1e6 * (method.used_s - since_s) / count)
    return float(np.median(taken_us[1:]))


def _wire(
    contract: Contract, bus: int, counter: int, sums: npt.NDArray[np.int32]
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.intp]]:
    """Return the datagrams of one cycle on a bus, and their lengths."""
    table, cycle = contract.table, contract.cycle(bus, contract.turn_of(counter))
    row = table.row_of[bus, cycle["can_id"][1:]]
    cycle["data"][0, 0] = counter
    cycle["data"][1:, : table.length[0]] = codec.encode(counter, sums, table.gather[row], contract.packing)
    return encode(cycle)


def _sender(far: socket.socket) -> BatchSocket:
    far.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, RECEIVE_BUFFER_BYTES)
    return BatchSocket(far, BATCH_FRAMES, FD_BYTES)


class _DatagramLink(SocketCanLink):
    """Our SocketCAN link on a datagram socket; the kernel marks no echo there, so SYNC is marked here.

    Attributes
    ----------
    cycle_ns : int
        When the frames came, in place of the kernel's time: a cycle lasts as long as its wake-ups take.
    """

    cycle_ns = 0

    def __init__(self, near: socket.socket) -> None:
        self._near = near
        super().__init__("bench")

    def _open(self) -> socket.socket:
        self._near.setblocking(False)
        for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL):
            self._near.setsockopt(socket.SOL_SOCKET, option, 1)
        return self._near

    def receive(self) -> Frames:
        """Return all waiting frames, SYNC as echo."""
        arrived = super().receive()
        arrived["flags"][arrived["can_id"] == SYNC_COB_ID] = ECHO
        arrived["time_ns"] = self.cycle_ns
        return arrived


class _Ours:
    """The gateway's loop; nodes are proven, and its commands go nowhere."""

    def __init__(self, contract: Contract, links: Sequence[_DatagramLink]) -> None:
        self._links = dict(enumerate(links))
        self._now_s, self._period_s, self._turns = 1.0, contract.layout.sync.period_s, contract.turns
        self._loop = GatewayLoop(
            contract, dict.fromkeys(self._links, len), self._now_s, say=lambda _: None, complain=lambda _: None
        )
        for node in contract.nodes:
            self._loop.gathering.trust(node, proven=True)
        self._made: list[Any] = []
        self._number, self._counter = 0, 0
        self.used_s = 0.0

    def begin(self) -> None:
        started_s = time.thread_time()
        self._now_s += self._period_s
        now_ns = round(1e9 * self._now_s)
        for link in self._links.values():
            link.cycle_ns = now_ns
        self._number, self._counter = self._number + 1, next_counter(self._counter)
        self._made = self._loop.gathering.begin(Sync(self._number, self._counter, now_ns, now_ns, 0))
        self.used_s += time.thread_time() - started_s

    def wake(self, _sent: int) -> None:
        started_s = time.thread_time()
        ready = select(list(self._links.values()), [], [], 0.0)[0]
        for number, link in self._links.items():
            if link in ready:
                self._loop.take(
                    number,
                    link.receive(),
                    self._now_s,
                    state=link.state,
                    dropped=link.dropped,
                    stamp_error_ns=link.stamp_error_ns,
                )
        self._made += self._loop.measurements(self._now_s)
        self.used_s += time.thread_time() - started_s

    def end(self) -> Integers:
        (made,) = self._made
        if self._number >= self._turns and not all(made.valid):
            raise RunError("expected a complete measurement, got blocks that are not valid")
        return np.frombuffer(made.sums, "<i4").astype(np.int64)


@contextmanager
def _ours(contract: Contract, sockets: list[socket.socket]) -> Iterator[_Method]:
    with ExitStack() as opened:
        links = [_DatagramLink(near) for near in sockets]
        for link in links:
            opened.callback(link.close)
        yield _Ours(contract, links)


class _Threads:
    """Sums that the threads of a peer gather: `take` is called with the first sum of a frame and its sums."""

    def __init__(self, contract: Contract) -> None:
        self._packing = contract.packing
        self._sums = [0] * contract.phi.shape[0]
        self._expected = len(contract.table.bus) // contract.turns
        self._buses = len(contract.layout.bus)
        self._came = 0
        self._lock = threading.Lock()
        #: Clocks of the threads that have called.
        self._clocks: dict[int, int] = {}
        self._result = np.zeros(len(self._sums), np.int64)
        self._is_whole = threading.Event()

    @property
    def used_s(self) -> float:
        return sum(map(time.clock_gettime, list(self._clocks.values())))

    def note_thread(self) -> None:
        """Count the processor time of this thread."""
        thread = threading.get_ident()
        self._clocks[thread] = time.pthread_getcpuclockid(thread)

    def take(self, first: int, sums: tuple[int, ...]) -> None:
        self._sums[first : first + len(sums)] = sums
        with self._lock:
            self._came += 1
            is_whole = self._came == self._expected
        if is_whole:
            self._result = self._packing.counts(np.array(self._sums, np.int32)).astype(np.int64)
            self._is_whole.set()

    def begin(self) -> None:
        self._came = 0
        self._is_whole.clear()

    def wake(self, sent: int) -> None:
        expected, ends_s = min(self._buses * (sent - 1), self._expected), time.monotonic() + _PATIENCE_S
        while self._came < expected:
            if time.monotonic() > ends_s:
                raise RunError(f"expected {expected} frames, got {self._came} in {_PATIENCE_S:g} s")
            time.sleep(_LOOK_S)

    def end(self) -> Integers:
        self._is_whole.wait(_PATIENCE_S)
        return self._result


def _unpacking(contract: Contract) -> Callable[[bytes], tuple[int, ...]]:
    """Return what a user would write for the sums of a frame: shifts of one integer."""
    bits, count = contract.packing.bits, contract.nodes[0].tpdos[0].sums
    sign, mask = 1 << bits - 1, (1 << bits) - 1

    def unpacked(data: bytes) -> tuple[int, ...]:
        packed = int.from_bytes(data[COUNTER_BYTES:], "little")
        return tuple((packed >> bits * place & mask ^ sign) - sign for place in range(count))

    return unpacked


class _DatagramBus(SocketcanBus):
    """python-can's SocketCAN interface on a datagram socket."""

    def __init__(self, near: socket.socket, number: int) -> None:
        near.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.socket, self.channel, self.channel_info = near, f"can{number}", f"datagram socket {number}"
        self._bcm_sockets = {}
        can.BusABC.__init__(self, channel=self.channel)

    def _apply_filters(self, filters: Any) -> None:  # noqa: ARG002  python-can's interface
        """There is nothing to filter, and the kernel would filter."""
        self._is_filtered = True


@contextmanager
def _python_can(contract: Contract, sockets: list[socket.socket]) -> Iterator[_Method]:
    """Gather sums in a listener of a Notifier."""
    threads, notifiers = _Threads(contract), []
    unpacked = _unpacking(contract)

    def listen(first_of: dict[int, int], message: can.Message) -> None:
        first = first_of.get(message.arbitration_id)
        if first is None:
            threads.note_thread()  # SYNC
        else:
            threads.take(first, unpacked(bytes(message.data)))

    buses = [_DatagramBus(near, number) for number, near in enumerate(sockets)]
    try:
        for number, bus in enumerate(buses):
            first_of = {tpdo.cob_id: tpdo.first_sum for node in contract.on_bus(number) for tpdo in node.tpdos}
            notifiers.append(can.Notifier(bus, [partial(listen, first_of)], timeout=0.1))
        yield threads
    finally:
        for notifier in notifiers:
            notifier.stop()
        for bus in buses:
            bus.shutdown()


@contextmanager
def _canopen(contract: Contract, sockets: list[socket.socket]) -> Iterator[_Method]:
    """Gather sums in callbacks of the PDOs that the nodes' DCFs describe.

    The library reads a variable of up to 16 bits from two bytes, and a sum may lie in three: sums are unpacked here.
    """
    threads, networks = _Threads(contract), []
    unpacked = _unpacking(contract)
    files = {node: text for kind in node_types(contract) for node, text in dcfs(contract, kind)}

    def take(first: int, pdo: Any) -> None:
        threads.take(first, unpacked(bytes(pdo.data)))

    for number, near in enumerate(sockets):
        network = canopen.Network(_DatagramBus(near, number))
        network.NOTIFIER_CYCLE = 0.1
        network.subscribe(SYNC_COB_ID, lambda *_: threads.note_thread())
        for node in contract.on_bus(number):
            remote = network.add_node(
                canopen.RemoteNode(node.node_id, import_eds(io.StringIO(files[node]), node.node_id))
            )
            for tpdo in node.tpdos:
                pdo = remote.tpdo[tpdo.number]
                pdo.read(from_od=True)
                pdo.add_callback(partial(take, tpdo.first_sum))
        networks.append(network)
    try:
        for network in networks:
            network.connect()
        yield threads
    finally:
        for network in networks:
            network.disconnect()
