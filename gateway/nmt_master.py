"""The NMT master of one bus: proves each node's configuration, starts the node, and restarts lost nodes.

After CiA 302-2, boot NMT slave and error control, as a table: `NmtMaster.TRANSITIONS`, at the end of the file, has the
action and the next state for each `NodeState` and `Event`. The sums of a node are used from `_start_using` to
`_stop_using`, in the states `IN_USE` and `IN_USE_CHECKED`; in others the blocks of the node are not valid
(`Gathering.trust`). The NMT state of CiA 301, which a node tells in its heartbeats, is `NodeRecord.nmt`. Time and
frames are arguments; no function waits.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, IntEnum, auto
from functools import partial
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from canskin.messages import SILENT
from dbc.canopen import (
    COMMANDED,
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
    NmtState,
    state_text,
)
from dbc.configuration import (
    DIALOGUES,
    PROOF_ROUNDS,
    QUIET_S,
    TICK_S,
    Setting,
    calibration,
    configuration,
    expected_signature,
    proof_period_s,
)
from dbc.contract import Contract, NodeContract
from dbc.dictionary import SILENT_AFTER_S
from dbc.frame import CAN_ID_AT, ECHO, ERROR, EXTENDED, FLAGS_AT, REMOTE, Frames, frame_bytes, frames
from gateway.foreign_sdo import CONFIGURATION, GAINS, Effect, ForeignClient
from gateway.grouped_lines import GroupedLines
from gateway.proof import Known, Proof, prove
from gateway.sdo import ATTEMPTS, TIMEOUT_S, Dialogue, SdoDialogue
from gateway.strangers import Strangers
from shell.compiled import njit

#: Pause before each attempt to restart a node. After the last attempt, one attempt follows every `LATER_S`.
PAUSES_S: Final = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0)
LATER_S: Final = 60.0
#: After this long in OPERATIONAL, the next loss begins with the shortest pause.
STABLE_S: Final = 10.0
#: On the bus, a heartbeat with the old state may come this much later than the NMT start.
UNDER_WAY_NS: Final = 300_000_000
#: An emergency at most this long before a node left is logged as the reason.
EXPLAINS_S: Final = 2.0
#: Longest time for which proven nodes wait for the first proofs of others: a silent node is asked once.
QUIET_MAX_S: Final = TIMEOUT_S

Send = Callable[[int, bytes], None]
#: Of the table: called with a node, the time, and the reason for the log.
_Action = Callable[["NmtMaster", "NodeRecord", float, str], None]


class NodeState(IntEnum):
    """How far a node has come; from `IN_USE` on, its sums are used."""

    WAITING = auto()  #: Not in use: never heard, lost, or silent. The next proof begins after a pause.
    CHECKED = auto()  #: Not in use, and a proof is under way.
    REFUSED = auto()  #: Not in use: its configuration is not that of the layout. It is proven again after a minute.
    REFUSED_CHECKED = auto()  #: Refused, and a proof is under way.
    IN_USE = auto()  #: Proven and started.
    IN_USE_CHECKED = auto()  #: In use, and proven again in its turn.


#: States with an open proof, and of nodes whose sums must not be used.
_CHECKED: Final = (NodeState.CHECKED, NodeState.REFUSED_CHECKED, NodeState.IN_USE_CHECKED)
_REFUSED: Final = (NodeState.REFUSED, NodeState.REFUSED_CHECKED)


class Event(Enum):
    """What happens to a node."""

    DUE = auto()  #: The time of its next proof has come.
    DIFFERENT = auto()  #: The proof has found a difference, and goes on.
    RIGHT = auto()  #: The proof has ended: the configuration is right.
    WRONG = auto()  #: The proof has ended: the configuration is wrong, and stays so.
    UNANSWERED = auto()  #: The proof has ended without an answer.
    BOOTED = auto()  #: Boot-up message.
    HEARD = auto()  #: First heartbeat after silence.
    LEFT = auto()  #: A heartbeat, or a command of another master, says that the node has left OPERATIONAL.
    RUNNING = auto()  #: A refused node is OPERATIONAL.
    LOST = auto()  #: The heartbeat is overdue.
    OUTDATED = auto()  #: The newest proof is too old.
    WRITTEN = auto()  #: Another master writes the configuration.
    BUSY = auto()  #: Another master uses the SDO channel: a node answers one client at a time.


@dataclass
class NodeRecord:
    """State of one node; times are monotonic seconds.

    Attributes
    ----------
    signature : int
        The configuration signature (2006h) that the contract asks for.
    known : Known
        The node's gains and offsets, as the newest proof has found them.
    foreign : ForeignClient
        The SDO requests of other masters to the node.
    nmt : int
        NMT state that the node told last, `SILENT` when its heartbeat is overdue.
    state : NodeState
    started_ns : int or None
        When the newest NMT start of the gateway was on the bus; None while the start waits in the controller.
    proven_s : float
        When the newest successful proof read its oldest value.
    prove_at_s : float
        When the next proof of a node begins; infinite in use, where proofs come in turn.
    tries : int
        Dialogues since the node was last stable in OPERATIONAL.
    asked : bool
        The first dialogue has ended.
    heard_s, emcy_s, used_since_s, commanded_s, began_s : float
        Times of the newest heartbeat, the newest active emergency, the newest start of use, the gateway's newest NMT
        start, and the beginning of the newest proof.
    refusal : str
        Why the node is refused; empty in the other states.
    dialogue : SdoDialogue or None
        The open proof, in the states `*CHECKED`.
    errand : SdoDialogue or None
        The open dialogue of a node in use about something else: `NmtMaster.ask`.
    hint : str
        The reason that the log gives for the next boot.
    lost_s : float or None
        When the node's sums were given up; None while they are used, or before their first use.
    """

    contract: NodeContract
    settings: Sequence[Setting]
    signature: int
    known: Known
    foreign: ForeignClient
    state: NodeState = NodeState.WAITING
    nmt: int = SILENT
    heard_s: float = -np.inf
    emcy: int = 0
    emcy_s: float = -np.inf
    used_since_s: float = -np.inf
    commanded_s: float = -np.inf
    started_ns: int | None = 0
    proven_s: float = -np.inf
    refusal: str = ""
    dialogue: SdoDialogue | None = None
    errand: SdoDialogue | None = None
    began_s: float = -np.inf
    prove_at_s: float = 0.0
    #: Transfers of the last proof.
    cost: int = 1
    tries: int = 0
    asked: bool = False
    lost_s: float | None = None
    hint: str = ""

    @property
    def in_use(self) -> bool:
        """Whether the node's sums are used."""
        return self.state >= NodeState.IN_USE

    @property
    def is_free(self) -> bool:
        """Whether no dialogue with the node is open: it answers one request at a time."""
        return self.dialogue is None and self.errand is None

    def explanation(self, now_s: float) -> str:
        """Return the emergency that explains why the node leaves now, empty without one."""
        return f" after EMCY {self.emcy:04X}h" if now_s - self.emcy_s < EXPLAINS_S else ""

    def end_errand(self) -> None:
        """Drop the errand if it is done."""
        if self.errand is not None and self.errand.done:
            self.errand = None


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
    nodes : dict of int to NodeRecord
        State of every node, by node-ID; for reading.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int,
        send: Send,
        use: Callable[[NodeContract, bool], None],
        say: Callable[[str], None],
    ) -> None:
        self._name = contract.layout.bus[bus].name
        self._write = contract.layout.configure == "write"
        #: Nodes that run send by themselves: a proof would wait for their sums.
        self._in_steps = not contract.layout.sends.in_cycles
        self._is_new = True
        #: Since when all nodes are to be quiet (`restart`); None while they may send.
        self._quiet_since_s: float | None = None
        self._send = send
        self._use = use
        self.nodes = {
            node.node_id: NodeRecord(
                node,
                settings,
                expected_signature(settings),
                Known(gains),
                ForeignClient({each.index: CONFIGURATION for each in settings} | {each.index: GAINS for each in gains}),
            )
            for node in contract.on_bus(bus)
            for settings, gains in [(configuration(contract, node), calibration(contract, node))]
        }
        self.node_ids = list(self.nodes)
        self._round_s = proof_period_s(contract, bus)
        self._slot_s = self._tick_s = -np.inf
        self._lines = GroupedLines(self._name, say)
        #: Other devices on the bus.
        self.strangers = Strangers(send)
        #: Emergencies since the list was last cleared: node-ID and error code.
        self.emergencies: list[tuple[int, int]] = []
        #: Nodes whose gains or offsets have become others since the list was last cleared, and not by the gateway.
        self.recalibrated: list[NodeContract] = []
        _places(frame_bytes(frames(0)))  # compiled before the first frame

    @property
    def passed(self) -> bool:
        """Whether every node's first dialogue has ended, with or without an answer."""
        return all(node.asked for node in self.nodes.values())

    @property
    def is_quiet(self) -> bool:
        """Whether all nodes are stopped for a while, see `restart`."""
        return self._quiet_since_s is not None

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
        return [node_id for node_id, node in self.nodes.items() if node.state in _REFUSED]

    @property
    def awaited(self) -> list[int]:
        """Node-IDs neither proven nor refused; in most cases the node is absent."""
        return [node_id for node_id, node in self.nodes.items() if node.state < NodeState.REFUSED]

    @property
    def proof_limit_s(self) -> float:
        """How long a block stays valid after the last proof of its node."""
        mean_cost = sum([node.cost for node in self.nodes.values()]) / len(self.nodes)
        return PROOF_ROUNDS * self._round_s * mean_cost + ATTEMPTS * TIMEOUT_S

    # What arrives

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use the frames of the bus, in bus order."""
        for place in _places(frame_bytes(arrived)):
            frame = arrived[place]
            identifier, time_ns = int(frame["can_id"]), int(frame["time_ns"])
            base, node_id = identifier & ~HIGHEST_NODE_ID, identifier & HIGHEST_NODE_ID
            node = self.nodes.get(node_id)
            data = frame["data"][: frame["length"]].tobytes()
            if identifier == NMT_COB_ID and len(data) == NMT_BYTES:
                if not frame["flags"] & ECHO:
                    self._foreign_nmt(data[0], data[1], now_s)
                elif data[0] == NmtCommand.START:
                    for started in self._addressed(data[1]):
                        started.started_ns = time_ns
            elif node is not None:
                if base == HEARTBEAT_BASE and len(data) == HEARTBEAT_BYTES:
                    self._heartbeat(node, data[0] & 0x7F, time_ns, now_s)
                else:
                    self._take_of(node, base, data, now_s)
            elif node_id and base == HEARTBEAT_BASE and len(data) == HEARTBEAT_BYTES:
                self.strangers.heard(node_id)
            elif node_id:
                self.strangers.take(base, node_id, data, now_s)

    def _take_of(self, node: NodeRecord, base: int, data: bytes, now_s: float) -> None:
        if base == SDO_RESPONSE_BASE and len(data) == SDO_BYTES:
            if node.foreign.take_answer(data):
                if (asking := node.dialogue or node.errand) is not None:
                    asking.ask_again(data, now_s)
            elif node.dialogue is not None:
                node.dialogue.take(data, now_s)
                self._finish(node, now_s)
                self._begin_due(now_s)
            elif node.errand is not None:
                node.errand.take(data, now_s)
                node.end_errand()
        elif base == SDO_REQUEST_BASE and len(data) == SDO_BYTES:
            self._foreign_sdo(node, data, now_s)
        elif base == EMCY_BASE and len(data) == EMCY_BYTES:
            node.emcy = int.from_bytes(data[:2], "little")
            node.emcy_s = now_s if node.emcy else -np.inf
            if node.emcy:
                self.emergencies.append((node.contract.node_id, node.emcy))

    def _heartbeat(self, node: NodeRecord, state: int, time_ns: int, now_s: float) -> None:
        was_silent = node.nmt == SILENT
        node.heard_s = now_s
        if state == NmtState.INITIALISING:
            self._booted(node, now_s)
            return
        if state != NmtState.OPERATIONAL and node.in_use:
            is_under_way = node.started_ns is None or time_ns - node.started_ns < UNDER_WAY_NS
            if is_under_way and now_s - node.commanded_s < SILENT_AFTER_S:
                return
            why = f"left OPERATIONAL: {state_text(state)}{node.explanation(now_s)}"
            node.nmt = state
            self._happen(node, Event.LEFT, now_s, why)
            return
        node.nmt = state
        if was_silent:
            self._happen(node, Event.HEARD, now_s)

    def _booted(self, node: NodeRecord, now_s: float) -> None:
        if node.nmt == SILENT or node.refusal or node.hint:  # somebody has worked on the node
            node.tries = 0
        node.foreign.booted()
        why = f"booted again{node.hint or node.explanation(now_s)}"
        node.nmt, node.hint = NmtState.PRE_OPERATIONAL, ""
        self._happen(node, Event.BOOTED, now_s, why)

    def _foreign_nmt(self, command: int, node_id: int, now_s: float) -> None:
        for node in self._addressed(node_id):
            if command in COMMANDED and command != NmtCommand.START and node.nmt != SILENT:
                node.nmt = COMMANDED[NmtCommand(command)]
                why = f"left OPERATIONAL: {state_text(node.nmt)}, by another master's NMT command"
                self._happen(node, Event.LEFT, now_s, why)
            elif command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
                node.hint = ", reset by another master"

    def _addressed(self, node_id: int) -> list[NodeRecord]:
        """Return the nodes that an NMT command is for: all for node-ID 0."""
        return [node for each, node in self.nodes.items() if node_id in {0, each}]

    def _foreign_sdo(self, node: NodeRecord, data: bytes, now_s: float) -> None:
        effect = node.foreign.take(data, now_s)
        if effect is Effect.DOUBT:
            node.known.doubt()
            self._happen(node, Event.WRITTEN, now_s, f"doubted: another master writes its {node.foreign.written}")
        elif effect is Effect.BUSY:
            node.errand = None
            self._happen(node, Event.BUSY, now_s)

    # What time calls for

    def tick(self, now_s: float) -> None:
        """Check times, begin dialogues, and start proven nodes; call it many times a second."""
        if now_s < self._tick_s:
            return
        self._tick_s = now_s + TICK_S
        if self._is_new and self._in_steps:
            self.restart(now_s)
        self._is_new = False
        limit_s = self.proof_limit_s
        for node in self.nodes.values():
            if node.dialogue is not None:
                node.dialogue.tick(now_s)
                self._finish(node, now_s)
            self._check_times(node, limit_s, now_s)
            if node.errand is not None:
                node.errand.tick(now_s)
                node.end_errand()
        self._begin_due(now_s)
        self._prove_in_turn(now_s)
        self._start_again(now_s)
        self._lines.tick(now_s)

    def restart(self, now_s: float) -> None:
        """Have every node in use send all its sums, as a node that enters OPERATIONAL does.

        All nodes become PRE-OPERATIONAL now: the bus is free for proofs. They start when all first proofs have ended,
        after `QUIET_S` to `QUIET_MAX_S`. Each node is commanded by its node-ID: node-ID 0 would stop a robot's drives
        that share the bus.
        """
        self._command(NmtCommand.ENTER_PRE_OPERATIONAL, *self.nodes)
        self._quiet_since_s = now_s
        for node in self.nodes.values():
            if node.in_use:
                self._expect_start(node, now_s)

    def ask(self, node_id: int, steps: Dialogue, now_s: float) -> SdoDialogue | None:
        """Begin a dialogue with a node in use, one attempt for each transfer; None while its SDO channel is busy."""
        node = self.nodes[node_id]
        if not node.in_use or not node.is_free or now_s < node.foreign.free_s:
            return None
        node.errand = SdoDialogue(node_id, steps, partial(self._ask, node), now_s, attempts=1)
        return node.errand

    def _begin_due(self, now_s: float) -> None:
        """Begin the proofs that are due, as many as there may be; another master's download goes on undisturbed."""
        tried = [node for node in self.nodes.values() if now_s >= node.prove_at_s and node.dialogue is None]
        due = [node for node in tried if now_s >= node.foreign.free_s]
        if not due:
            return
        free = DIALOGUES - sum(node.dialogue is not None for node in self.nodes.values())
        for node in sorted(due, key=lambda node: node.prove_at_s)[: max(0, free)]:
            self._happen(node, Event.DUE, now_s)

    def _start_again(self, now_s: float) -> None:
        """End the quiet time: start all nodes in use."""
        if self._quiet_since_s is None:
            return
        quiet_s = now_s - self._quiet_since_s
        if quiet_s < (QUIET_S if self.passed else QUIET_MAX_S):
            return
        self._quiet_since_s = None
        used = [node_id for node_id, node in self.nodes.items() if node.in_use]
        for node_id in used:
            self._expect_start(self.nodes[node_id], now_s)
        self._command(NmtCommand.START, *used)

    @staticmethod
    def _expect_start(node: NodeRecord, now_s: float) -> None:
        """Take no heartbeat with another state amiss until the node's start has been on the bus."""
        node.started_ns, node.commanded_s = None, now_s
        node.nmt, node.heard_s = NmtState.OPERATIONAL, now_s

    def stop(self) -> None:
        """Command all nodes to PRE-OPERATIONAL."""
        self._command(NmtCommand.ENTER_PRE_OPERATIONAL, *self.nodes)
        self._lines.flush()

    def _check_times(self, node: NodeRecord, limit_s: float, now_s: float) -> None:
        """Find a heartbeat or a proof that is overdue, and a refused node that sends PDOs."""
        if node.nmt != SILENT and now_s - node.heard_s > SILENT_AFTER_S:
            node.nmt = SILENT
            self._happen(node, Event.LOST, now_s, f"silent: no heartbeat for {SILENT_AFTER_S:g} s")
        if node.refusal and node.nmt == NmtState.OPERATIONAL:
            self._happen(node, Event.RUNNING, now_s)
        if node.tries and node.in_use and now_s - node.used_since_s > STABLE_S:
            node.tries = 0
        if now_s - node.proven_s > limit_s and node.in_use:
            self._happen(node, Event.OUTDATED, now_s, f"not proven for {now_s - node.proven_s:.0f} s")

    def _prove_in_turn(self, now_s: float) -> None:
        """Prove the node whose proof is oldest, as often as the share of the bus for proofs allows."""
        if now_s < self._slot_s:
            return
        share_s = self._round_s / len(self.nodes)
        self._slot_s = max(self._slot_s, now_s - share_s) + share_s
        waiting = [node for node in self.nodes.values() if node.in_use and node.is_free]
        oldest = min(waiting, key=lambda node: node.began_s, default=None)
        if oldest is None:
            return
        if now_s < oldest.foreign.free_s and now_s - oldest.began_s < self._round_s * oldest.cost:
            return
        self._slot_s += (oldest.cost - 1) * share_s
        self._happen(oldest, Event.DUE, now_s)

    def _finish(self, node: NodeRecord, now_s: float) -> None:
        """Act on the result of a proof that has ended."""
        dialogue = node.dialogue
        if dialogue is None or not dialogue.done:
            return
        node.asked = True
        proof = dialogue.result
        if not isinstance(proof, Proof):
            self._happen(node, Event.UNANSWERED, now_s)
            return
        node.cost = proof.cost
        if proof.written:
            self._lines.add(node.contract.node_id, f"set right: {proof.written}", now_s)
        if proof.refusal:
            self._happen(node, Event.WRONG, now_s, proof.refusal)
            return
        if node.known.take(proof.gains):
            self.recalibrated.append(node.contract)
            doubt = ", and its forces are doubtful until 'skin tare'" if node.known.is_doubtful else ""
            self._lines.add(node.contract.node_id, f"{GAINS} have changed: its zero counts no longer{doubt}", now_s)
        # A proof holds from its oldest read.
        node.proven_s = dialogue.asked_s if proof.is_one_read else node.began_s
        self._happen(node, Event.RIGHT, now_s)

    def _happen(self, node: NodeRecord, event: Event, now_s: float, why: str = "") -> None:
        """Do what `TRANSITIONS` says; `why` is for the log."""
        found = self.TRANSITIONS[node.state].get(event)
        if found is None:
            return
        act, node.state = found
        if node.state not in _CHECKED:
            node.dialogue = None
        if node.state not in _REFUSED:
            node.refusal = ""
        act(self, node, now_s, why)

    # The actions of the table

    def _start_using(self, node: NodeRecord, now_s: float, _why: str) -> None:
        """Use the sums of a proven node and start it; attempts before its first start are not counted."""
        node.used_since_s, node.prove_at_s, node.hint = now_s, np.inf, ""
        self._use(node.contract, True)
        if self.is_quiet or node.nmt != NmtState.OPERATIONAL:
            self._expect_start(node, now_s)
            if not self.is_quiet:
                self._command(NmtCommand.START, node.contract.node_id)
        if node.lost_s is not None:
            self._lines.add(node.contract.node_id, f"back after {now_s - node.lost_s:.1f} s", now_s)
            node.lost_s = None
        else:
            node.tries = 0  # the first start, not a restart

    def _stop_using(self, node: NodeRecord, now_s: float, why: str) -> None:
        """Use no more sums of a node; try to restart it after a pause."""
        node.errand = None
        self._use(node.contract, False)
        if node.lost_s is None:
            node.lost_s = now_s
        self._lines.add(node.contract.node_id, why, now_s)
        self._pause(node, now_s, why)

    def _prove(self, node: NodeRecord, now_s: float, _why: str) -> None:
        """Begin a proof."""

        def doubt(why: str) -> None:
            self._happen(node, Event.DIFFERENT, now_s, why)

        node.began_s = now_s
        steps = prove(node.settings, node.signature, node.known, write=self._write, in_use=node.in_use, doubt=doubt)
        # One attempt for a silent node: the boot-up message or heartbeat tells when the node is there.
        attempts = 1 if node.nmt == SILENT else ATTEMPTS
        node.dialogue = SdoDialogue(node.contract.node_id, steps, partial(self._ask, node), now_s, attempts=attempts)

    def _ask(self, node: NodeRecord, can_id: int, data: bytes) -> None:
        node.foreign.ask(data)
        self._send(can_id, data)

    def _try(self, node: NodeRecord, now_s: float, why: str) -> None:
        """Begin to prove a node that is not in use."""
        # A stopped node answers no SDO (CiA 301, 7.3.2.2.4), and a node without heartbeat may be stopped. A stepped
        # node may also run: it sends all its sums only when it starts.
        may_be_stopped = node.nmt == SILENT and (node.tries > 0 or self._in_steps) and not self.is_quiet
        if node.nmt == NmtState.STOPPED or may_be_stopped:
            self._command(NmtCommand.ENTER_PRE_OPERATIONAL, node.contract.node_id)
        node.tries += 1
        self._prove(node, now_s, why)

    def _refuse(self, node: NodeRecord, now_s: float, why: str) -> None:
        """Tell why; try again later."""
        if why != node.refusal:
            self._lines.add(node.contract.node_id, f"refused: {why}", now_s)
        node.refusal, node.prove_at_s = why, now_s + LATER_S

    def _halt(self, node: NodeRecord, _now_s: float, _why: str) -> None:
        """End the PDOs of a refused node: they may have identifiers of other nodes."""
        self._command(NmtCommand.ENTER_PRE_OPERATIONAL, node.contract.node_id)
        node.nmt = NmtState.PRE_OPERATIONAL

    def _pause(self, node: NodeRecord, now_s: float, _why: str) -> None:
        """Set the time of the next try."""
        is_over = node.tries >= len(PAUSES_S)
        node.prove_at_s = now_s + (LATER_S if is_over else PAUSES_S[node.tries])
        if node.tries == len(PAUSES_S) and node.nmt != SILENT:
            self._lines.add(
                node.contract.node_id, f"given up after {len(PAUSES_S)} tries: tried again every {LATER_S:g} s", now_s
            )

    def _pause_if_lost(self, node: NodeRecord, now_s: float, why: str) -> None:
        """Set the time of the next try: now for a node that was never in use."""
        if node.lost_s is None:
            node.prove_at_s = now_s
        else:
            self._pause(node, now_s, why)

    def _try_now(self, node: NodeRecord, now_s: float, _why: str) -> None:
        """Begin the tries anew."""
        node.tries = 0
        node.prove_at_s = min(node.prove_at_s, now_s)

    def _try_when_free(self, node: NodeRecord, _now_s: float, _why: str) -> None:
        """Try again as soon as the other master leaves the SDO channel alone."""
        node.prove_at_s = node.foreign.free_s

    def _give_way(self, node: NodeRecord, _now_s: float, _why: str) -> None:
        """Begin the proof again when the SDO channel is free; a node in use keeps its turn."""
        node.began_s = node.proven_s
        node.prove_at_s = max(node.prove_at_s, node.foreign.free_s)

    def _go_on(self, node: NodeRecord, now_s: float, why: str) -> None:
        """Do nothing."""

    def _command(self, command: NmtCommand, *node_ids: int) -> None:
        for node_id in node_ids:
            self._send(NMT_COB_ID, bytes((command, node_id)))

    #: By state and event: the action, and the next state. In a state that does not list an event, it changes nothing.
    TRANSITIONS: ClassVar[dict[NodeState, dict[Event, tuple[_Action, NodeState]]]] = {
        NodeState.WAITING: {
            Event.DUE: (_try, NodeState.CHECKED),
            Event.BOOTED: (_pause_if_lost, NodeState.WAITING),
            Event.HEARD: (_try_now, NodeState.WAITING),
            Event.WRITTEN: (_give_way, NodeState.WAITING),
        },
        NodeState.CHECKED: {
            Event.RIGHT: (_start_using, NodeState.IN_USE),
            Event.WRONG: (_refuse, NodeState.REFUSED),
            Event.UNANSWERED: (_pause, NodeState.WAITING),
            Event.BOOTED: (_pause_if_lost, NodeState.WAITING),
            Event.HEARD: (_try_now, NodeState.CHECKED),
            Event.WRITTEN: (_give_way, NodeState.WAITING),
            Event.BUSY: (_give_way, NodeState.WAITING),
        },
        NodeState.REFUSED: {
            Event.DUE: (_try, NodeState.REFUSED_CHECKED),
            Event.BOOTED: (_pause_if_lost, NodeState.WAITING),
            Event.HEARD: (_try_now, NodeState.REFUSED),
            Event.RUNNING: (_halt, NodeState.REFUSED),
            Event.LOST: (_go_on, NodeState.WAITING),
            Event.WRITTEN: (_try_when_free, NodeState.REFUSED),
        },
        NodeState.REFUSED_CHECKED: {
            Event.RIGHT: (_start_using, NodeState.IN_USE),
            Event.WRONG: (_refuse, NodeState.REFUSED),
            Event.UNANSWERED: (_pause, NodeState.REFUSED),
            Event.BOOTED: (_pause_if_lost, NodeState.WAITING),
            Event.HEARD: (_try_now, NodeState.REFUSED_CHECKED),
            Event.RUNNING: (_halt, NodeState.REFUSED_CHECKED),
            Event.LOST: (_go_on, NodeState.CHECKED),
            Event.WRITTEN: (_try_when_free, NodeState.REFUSED),
            Event.BUSY: (_give_way, NodeState.REFUSED),
        },
        NodeState.IN_USE: {
            Event.DUE: (_prove, NodeState.IN_USE_CHECKED),
            Event.BOOTED: (_stop_using, NodeState.WAITING),
            Event.LEFT: (_stop_using, NodeState.WAITING),
            Event.LOST: (_stop_using, NodeState.WAITING),
            Event.OUTDATED: (_stop_using, NodeState.WAITING),
            Event.WRITTEN: (_stop_using, NodeState.WAITING),
        },
        NodeState.IN_USE_CHECKED: {
            Event.RIGHT: (_go_on, NodeState.IN_USE),
            Event.DIFFERENT: (_stop_using, NodeState.CHECKED),
            Event.UNANSWERED: (_go_on, NodeState.IN_USE),
            Event.BOOTED: (_stop_using, NodeState.WAITING),
            Event.LEFT: (_stop_using, NodeState.CHECKED),
            Event.LOST: (_stop_using, NodeState.CHECKED),
            Event.OUTDATED: (_stop_using, NodeState.CHECKED),
            Event.WRITTEN: (_stop_using, NodeState.WAITING),
            Event.BUSY: (_give_way, NodeState.IN_USE),
        },
    }


@njit(cache=True, nogil=True)
def _places(rows: npt.NDArray[np.uint8]) -> list[int]:
    """Return the places of the frames that a master uses: what nodes and masters say, and its own commands."""
    found = [0 for _ in range(0)]
    for place in range(rows.shape[0]):
        row = rows[place]
        can_id = 0
        for byte in range(4):
            can_id |= int(row[CAN_ID_AT + byte]) << (8 * byte)
        is_command = can_id == NMT_COB_ID
        is_ours = is_command or can_id > SDO_RESPONSE_BASE or EMCY_BASE < can_id <= EMCY_BASE + HIGHEST_NODE_ID
        is_plain = row[FLAGS_AT] & (ERROR | ECHO | EXTENDED | REMOTE) == 0
        if (is_plain and is_ours) or (row[FLAGS_AT] & (ERROR | ECHO) == ECHO and is_command):
            found.append(place)
    return found
