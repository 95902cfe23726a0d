"""``skin bench gateway``: frames per second of one core, from the socket to a complete measurement, against peers.

Each bus is a pair of datagram sockets that carries ``struct can_frame``, as a socket of CAN does, with the kernel's
time stamps. Each side waits in threads of its own, as in a running skin: ours in the turns of the gateway's service,
the peers in a thread per bus, with the code that they read a SocketCAN interface with. All threads share one processor,
whose caches are cold at each wake-up: on a live gateway other programs run between two. The time is that of the threads
from the system call that they wait in. The peers gather sums and nothing else; ours also judges every frame, counts the
load and looks after the nodes.
"""

import io
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager
from functools import partial
from typing import Any, Final, Protocol, cast

import can
import canopen
import numpy as np
import numpy.typing as npt
from can.interfaces.socketcan import SocketcanBus
from canopen.objectdictionary.eds import import_eds

from bus.datagrams import SO_RXQ_OVFL, SO_TIMESTAMPNS
from bus.socketcan import RECEIVE_BUFFER_BYTES, SocketCanLink
from canskin.errors import RunError
from canskin.fabric import Fabric
from canskin.messages import Measurement
from dbc import codec
from dbc.canopen import NmtState
from dbc.contract import Contract
from dbc.eds import dcfs, node_types
from dbc.frame import Frames
from dbc.packing import COUNTER_BYTES
from evaluation.result import Row
from gateway.gathering import Sync
from gateway.node_machine import NodeState
from gateway.service import GatewayService
from skin.layout import load_layout
from skin.layout_keys import changed
from skin.sync_counter import next_counter

#: Frames that wait on each bus when the reader wakes: the last are all sums of the bus.
WAKE_UPS: Final = (1, 8, 64)
#: Cycles of a round; before the first round, as many run and do not count.
CYCLES: Final = 5
#: Read between two wake-ups, so that the caches of the processor have nothing of the methods.
_COLD_BYTES: Final = 8 << 20
#: Longest wait for the threads to take what was sent.
_PATIENCE_S: Final = 10.0
#: Pause between two looks at whether they have.
_LOOK_S: Final = 2e-4
#: Longest wait of our thread for frames.
_IDLE_NS: Final = 200_000_000
Integers = npt.NDArray[np.int64]


class _Method(Protocol):
    """One way to make measurements of what the sockets carry."""

    def begin(self, counter: int) -> None:
        """Begin the cycle of a SYNC."""

    @property
    def taken(self) -> int:
        """Number of frames that were taken since the cycle began."""
        ...

    def end(self) -> Integers:
        """Return the sums of the cycle."""
        ...

    @property
    def used_s(self) -> float:
        """Processor time so far, seconds."""
        ...


def run(rounds: int) -> dict[str, Any]:
    """Return ``{"rows": […]}``: frames per second of one core for each number of frames a wake-up, and our ratio."""
    contract = Contract.from_layout(changed(load_layout(), sync={"turns": 1}))
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(allowed)})
    try:
        return {"rows": [_row(contract, frames, rounds) for frames in WAKE_UPS]}
    finally:
        os.sched_setaffinity(0, allowed)


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
    cold = np.ones(_COLD_BYTES // 8)
    with ExitStack() as opened:
        pairs = [socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM) for _ in buses]
        senders = [_DatagramLink(far) for _, far in pairs]
        for sender, (near, _) in zip(senders, pairs, strict=True):
            opened.callback(sender.close)
            opened.enter_context(near)
        method = opened.enter_context(make(contract, [near for near, _ in pairs]))
        counter, taken_us = 0, []
        for _ in range(rounds + 1):
            since_s, count = method.used_s, 0
            for _ in range(CYCLES):
                counter = next_counter(counter)
                sums = contract.packing.counts(_some(contract, random))
                cycles = [_frames(contract, bus, counter, sums) for bus in buses]
                method.begin(counter)
                sent = 0
                for begin in range(0, max(map(len, cycles)), frames):
                    cold.sum()
                    for sender, cycle in zip(senders, cycles, strict=True):
                        sent += sender.send(cycle[begin : begin + frames])
                    _await(method, sent)
                count += sent
                if not np.array_equal(method.end(), sums):
                    raise RunError("expected the sums that were sent, got others")
            taken_us.append(1e6 * (method.used_s - since_s) / count)
    return float(np.median(taken_us[1:]))


def _some(contract: Contract, random: np.random.Generator) -> npt.NDArray[np.int32]:
    low, high = contract.packing.raw_range
    return random.integers(low, high + 1, contract.phi.shape[0], np.int32)


def _await(method: _Method, sent: int) -> None:
    """Wait until all frames that were sent have been taken, and the threads wait for more."""
    ends_s = time.monotonic() + _PATIENCE_S
    while method.taken < sent:
        if time.monotonic() > ends_s:
            raise RunError(f"expected {sent} frames, got {method.taken} in {_PATIENCE_S:g} s")
        time.sleep(_LOOK_S)
    time.sleep(_LOOK_S)


def _frames(contract: Contract, bus: int, counter: int, sums: npt.NDArray[np.int32]) -> Frames:
    """Return the frames with sums of one cycle on a bus."""
    cycle = contract.cycle(bus, contract.turn_of(counter))[1:]
    table = contract.table
    row = table.row_of[bus, cycle["can_id"]]
    cycle["data"][:, : table.length[0]] = codec.encode(counter, sums, table.gather[row], contract.packing)
    return cycle


class _DatagramLink(SocketCanLink):
    """Our SocketCAN link on a datagram socket, where no SYNC comes back."""

    def __init__(self, near: socket.socket) -> None:
        self._near = near
        super().__init__("bench")

    def _open(self) -> socket.socket:
        self._near.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, RECEIVE_BUFFER_BYTES)
        for option in (SO_TIMESTAMPNS, SO_RXQ_OVFL):
            self._near.setsockopt(socket.SOL_SOCKET, option, 1)
        return self._near


class _Service(GatewayService):
    """The gateway's service, which does not rest while frames come; nodes are proven, and this module makes SYNC."""

    def waits_ns(self) -> tuple[int, int]:
        """Return the longest wait for frames, without a rest."""
        return 0, _IDLE_NS


class _Threads:
    """The threads that are started by a context, and their processor time."""

    def __enter__(self) -> None:
        self._before = set(threading.enumerate())

    def __exit__(self, *_: object) -> None:
        started = set(threading.enumerate()) - self._before
        self._clocks = [time.pthread_getcpuclockid(each.ident) for each in started if each.ident is not None]

    @property
    def used_s(self) -> float:
        return sum(map(time.clock_gettime, self._clocks))


class _Ours(_Threads):
    """A gateway's service in a thread; it is the fabric of this service, too."""

    def __init__(self, contract: Contract, links: Sequence[_DatagramLink]) -> None:
        self._now_s, self._number, self._before_cycle, self._begun_s = time.monotonic(), 0, 0, 0.0
        self._made: list[Measurement] = []
        self._is_made, self._stop = threading.Event(), threading.Event()
        self._service = _Service(contract, dict(enumerate(links)), cast("Fabric", self), clock=lambda: self._now_s)
        self._loop = self._service.loop
        for node in contract.nodes:
            self._loop.gathering.trust(node, proven=True)
            known = self._loop.masters[node.bus].nodes[node.node_id]
            known.state, known.nmt, known.proven_s = NodeState.IN_USE, NmtState.OPERATIONAL, np.inf
            known.heard_s = known.prove_at_s = np.inf
        self.thread = threading.Thread(target=self._run)

    def publish(self, _topic: object, message: Any) -> None:
        if isinstance(message, Measurement):
            self._made.append(message)
            self._is_made.set()

    def _run(self) -> None:
        while not self._stop.is_set():
            self._service.turn()

    def stop(self) -> None:
        self._stop.set()
        self.thread.join()

    @property
    def used_s(self) -> float:
        return super().used_s + self._begun_s

    def begin(self, counter: int) -> None:
        started_s = time.thread_time()
        self._now_s, self._number = time.monotonic(), self._number + 1
        now_ns = round(1e9 * self._now_s)
        self._before_cycle, self._loop.sync.counter = self._loop.gathering.counts.accepted, counter
        self._made += self._loop.gathering.begin(Sync(self._number, counter, now_ns, now_ns, 0))
        self._begun_s += time.thread_time() - started_s

    @property
    def taken(self) -> int:
        return self._loop.gathering.counts.accepted - self._before_cycle

    def end(self) -> Integers:
        self._is_made.wait(_PATIENCE_S)
        (made,) = self._made
        self._made.clear()
        self._is_made.clear()
        if not all(made.valid):
            raise RunError("expected a complete measurement, got blocks that are not valid")
        return np.frombuffer(made.sums, "<i4").astype(np.int64)


@contextmanager
def _ours(contract: Contract, sockets: list[socket.socket]) -> Iterator[_Method]:
    with ExitStack() as opened:
        links = [_DatagramLink(near) for near in sockets]
        for link in links:
            opened.callback(link.close)
        ours = _Ours(contract, links)
        opened.callback(ours.stop)
        with ours:
            ours.thread.start()
        yield ours


class _Peer(_Threads):
    """Sums that the threads of a peer gather: `take` is called with the first sum of a frame and its sums."""

    def __init__(self, contract: Contract) -> None:
        self._packing = contract.packing
        self._sums = [0] * contract.phi.shape[0]
        self._expected = len(contract.table.bus)
        self.taken = 0
        self._lock = threading.Lock()
        self._result = np.zeros(len(self._sums), np.int64)
        self._is_whole = threading.Event()

    def take(self, first: int, sums: tuple[int, ...]) -> None:
        self._sums[first : first + len(sums)] = sums
        with self._lock:
            self.taken += 1
            is_whole = self.taken == self._expected
        if is_whole:
            self._result = self._packing.counts(np.array(self._sums, np.int32)).astype(np.int64)
            self._is_whole.set()

    def begin(self, _counter: int) -> None:
        self.taken = 0
        self._is_whole.clear()

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
    peer, notifiers = _Peer(contract), []
    unpacked = _unpacking(contract)

    def listen(first_of: dict[int, int], message: can.Message) -> None:
        peer.take(first_of[message.arbitration_id], unpacked(bytes(message.data)))

    buses = [_DatagramBus(near, number) for number, near in enumerate(sockets)]
    try:
        with peer:
            for number, bus in enumerate(buses):
                first_of = {tpdo.cob_id: tpdo.first_sum for node in contract.on_bus(number) for tpdo in node.tpdos}
                notifiers.append(can.Notifier(bus, [partial(listen, first_of)], timeout=0.1))
        yield peer
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
    peer, networks = _Peer(contract), []
    unpacked = _unpacking(contract)
    files = {node: text for kind in node_types(contract) for node, text in dcfs(contract, kind)}

    def take(first: int, pdo: Any) -> None:
        peer.take(first, unpacked(bytes(pdo.data)))

    for number, near in enumerate(sockets):
        network = canopen.Network(_DatagramBus(near, number))
        network.NOTIFIER_CYCLE = 0.1
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
        with peer:
            for network in networks:
                network.connect()
        yield peer
    finally:
        for network in networks:
            network.disconnect()
