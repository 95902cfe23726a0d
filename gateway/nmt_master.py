"""The NMT master of one bus: passes frames to its nodes, and has them proven, started, and restarted.

Each node is a `gateway.node_machine.NodeMachine`; `gateway.proof_schedule` tells whose proof is next. While the sums of
a node are not used, its blocks are not valid.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.messages import NodeFault
from dbc.canopen import (
    EMCY_BASE,
    EMCY_BYTES,
    HEARTBEAT_BASE,
    HEARTBEAT_BYTES,
    HIGHEST_NODE_ID,
    NMT_BYTES,
    NMT_COB_ID,
    SDO_BYTES,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    NmtCommand,
)
from dbc.configuration import QUIET_S, compared, expected_signature, proof_period_s
from dbc.contract import Contract, NodeContract
from dbc.frame import ECHO, Frames
from gateway.foreign_sdo import CONFIGURATION, GAINS, ForeignClient
from gateway.grouped_lines import GroupedLines
from gateway.node_machine import REFUSED, BusOfNodes, NodeMachine, NodeState, Send
from gateway.proof import Known
from gateway.proof_schedule import ProofSchedule
from gateway.sdo import TIMEOUT_S, Dialogue, SdoDialogue
from gateway.strangers import Strangers

#: Longest time for which proven nodes wait for the first proofs of others: a silent node is asked once.
QUIET_MAX_S: Final = TIMEOUT_S


class NmtMaster:
    """NMT master of the nodes of one bus.

    Parameters
    ----------
    bus : int
        Number of the bus in the layout.
    send : callable
        Sends a classic frame: COB-ID and data.
    use : callable
        Called with a node and whether its sums are used from now on.
    say : callable
        Writes a line to the log.

    Attributes
    ----------
    node_ids : list of int
        In the order of the contract; `nmt` and `emcy` have the same order.
    nodes : dict of int to NodeMachine
        By node-ID; for reading.
    emergencies, recalibrated : list
        See `BusOfNodes`.
    strangers : Strangers
        Other devices on the bus.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int,
        send: Send,
        use: Callable[[NodeContract, bool], None],
        say: Callable[[str], None],
    ) -> None:
        self._lines = GroupedLines(contract.layout.bus[bus].name, say)
        self._bus = BusOfNodes(
            contract,
            send,
            use,
            self._lines,
            writes=contract.layout.configure == "write",
            in_steps=not contract.layout.sends.in_cycles,
        )
        self.nodes = {
            node.node_id: NodeMachine(
                self._bus,
                node,
                settings,
                expected_signature(settings),
                Known(gains),
                ForeignClient({each.index: CONFIGURATION for each in settings} | {each.index: GAINS for each in gains}),
            )
            for node in contract.on_bus(bus)
            for settings, gains in [compared(contract, node)]
        }
        self.node_ids = list(self.nodes)
        self._proofs = ProofSchedule([*self.nodes.values()], proof_period_s(contract, bus))
        self.strangers = Strangers(send)
        self.emergencies, self.recalibrated = self._bus.emergencies, self._bus.recalibrated
        self._is_new = True
        #: Of the newest look at times.
        self._limit_s = np.inf
        self._quiet_since_s = -np.inf

    @property
    def passed(self) -> bool:
        """Whether the first dialogue of every node that is not optional has ended, with or without an answer."""
        return all(node.asked or node.contract.is_optional for node in self.nodes.values())

    @property
    def is_quiet(self) -> bool:
        """Whether all nodes are stopped for a while, see `restart`."""
        return self._bus.is_quiet

    @property
    def nmt(self) -> npt.NDArray[np.uint8]:
        """NMT state in every node's last heartbeat, `SILENT` when the heartbeat is overdue; shape (nodes,)."""
        return np.array([node.nmt for node in self.nodes.values()], np.uint8)

    @property
    def emcy(self) -> list[int]:
        """Error code of the newest emergency of every node, 0 for none."""
        return [node.emcy for node in self.nodes.values()]

    @property
    def refused(self) -> list[int]:
        """Node-IDs that answer, but whose sums must not be used."""
        return [node_id for node_id, node in self.nodes.items() if node.state in REFUSED]

    @property
    def faults(self) -> dict[int, NodeFault]:
        """Why the sums of nodes are not used, by node-ID."""
        return {node_id: fault for node_id, node in self.nodes.items() if (fault := node.fault) is not None}

    @property
    def awaited(self) -> list[int]:
        """Node-IDs neither proven nor refused; in most cases the node is absent."""
        return [node_id for node_id, node in self.nodes.items() if node.state < NodeState.REFUSED]

    @property
    def proof_limit_s(self) -> float:
        """How long a block stays valid after the last proof of its node."""
        return self._proofs.limit_s

    def take(self, talk: Frames, now_s: float) -> None:
        """Use what nodes and masters say on the bus, in bus order (`gateway.batch.Batch.talk`)."""
        for frame in talk:
            identifier, time_ns = int(frame["can_id"]), int(frame["time_ns"])
            base, node_id = identifier & ~HIGHEST_NODE_ID, identifier & HIGHEST_NODE_ID
            data = frame["data"][: frame["length"]].tobytes()
            if identifier == NMT_COB_ID and len(data) == NMT_BYTES:
                self._take_command(data[0], data[1], time_ns, now_s, is_own=bool(frame["flags"] & ECHO))
            elif (node := self.nodes.get(node_id)) is not None:
                self._take_of(node, base, data, time_ns, now_s)
            elif node_id and base == HEARTBEAT_BASE and len(data) == HEARTBEAT_BYTES:
                self.strangers.heard(node_id)
            elif node_id:
                self.strangers.take(base, node_id, data, now_s)

    def _take_command(self, command: int, node_id: int, time_ns: int, now_s: float, *, is_own: bool) -> None:
        for each, node in self.nodes.items():
            if node_id not in {0, each}:
                continue
            if not is_own:
                node.take_foreign_command(command, now_s)
            elif command == NmtCommand.START:
                node.started_ns = time_ns

    def _take_of(self, node: NodeMachine, base: int, data: bytes, time_ns: int, now_s: float) -> None:
        if base == HEARTBEAT_BASE and len(data) == HEARTBEAT_BYTES:
            node.take_heartbeat(data[0] & 0x7F, time_ns, now_s)
        elif base == SDO_RESPONSE_BASE and len(data) == SDO_BYTES:
            if node.take_answer(data, now_s):
                self._proofs.begin_due(now_s)
        elif base == SDO_REQUEST_BASE and len(data) == SDO_BYTES:
            node.take_foreign_request(data, now_s)
        elif base == EMCY_BASE and len(data) == EMCY_BYTES:
            node.take_emergency(int.from_bytes(data[:2], "little"), now_s)

    def tick(self, now_s: float) -> None:
        """Check times, begin dialogues, and start proven nodes; call it each `TICK_S`."""
        if self._is_new and self._bus.in_steps:
            self.restart(now_s)
        self._is_new = False
        due = [node for node in self.nodes.values() if now_s >= node.due_s]
        if due:
            limit_s = self.proof_limit_s
            if limit_s < self._limit_s:
                due = [*self.nodes.values()]
            self._limit_s = limit_s
            for node in due:
                node.tick(limit_s, now_s)
            self._proofs.begin_due(now_s)
        self._proofs.prove_in_turn(now_s)
        self._start_again(now_s)
        self._lines.tick(now_s)

    def restart(self, now_s: float) -> None:
        """Have every node in use send all its sums, as a node that enters OPERATIONAL does.

        All nodes become PRE-OPERATIONAL now: the bus is free for proofs. They start when all first proofs have ended,
        after `QUIET_S` to `QUIET_MAX_S`. Each node is commanded by its node-ID: node-ID 0 would stop a robot's drives
        that share the bus.
        """
        self._bus.command(NmtCommand.ENTER_PRE_OPERATIONAL, *self.nodes)
        self._bus.is_quiet, self._quiet_since_s = True, now_s
        self._expect_starts(now_s)

    def _start_again(self, now_s: float) -> None:
        """End the quiet time: start all nodes in use."""
        if not self.is_quiet or now_s - self._quiet_since_s < (QUIET_S if self.passed else QUIET_MAX_S):
            return
        self._bus.is_quiet = False
        self._bus.command(NmtCommand.START, *self._expect_starts(now_s))

    def _expect_starts(self, now_s: float) -> list[int]:
        """Return the node-IDs in use; what they do from now on waits for their start."""
        used = [node_id for node_id, node in self.nodes.items() if node.in_use]
        for node_id in used:
            self.nodes[node_id].expect_start(now_s)
        return used

    def ask(self, node_id: int, steps: Dialogue, now_s: float) -> SdoDialogue | None:
        """Begin a dialogue with a node in use, one attempt for each transfer; None while its SDO channel is busy."""
        return self.nodes[node_id].ask(steps, now_s)

    def stop(self) -> None:
        """Command all nodes to PRE-OPERATIONAL."""
        self._bus.command(NmtCommand.ENTER_PRE_OPERATIONAL, *self.nodes)
        self._lines.flush()
