"""One node as its NMT master sees it: proven, used, lost, and tried again (CiA 302-2, boot NMT slave, error control).

`NodeMachine.TRANSITIONS` has the action and the next state for each `NodeState` and `Event`. The sums of a node are
used in the states `IN_USE` and `IN_USE_CHECKED`. The NMT state of CiA 301, which a node tells in its heartbeats, is
`NodeMachine.nmt`. Time and frames are arguments; no function waits.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import Enum, IntEnum, auto
from typing import ClassVar, Final

import numpy as np

from canskin.messages import SILENT, Fault, NodeFault
from dbc.canopen import COMMANDED, NMT_COB_ID, NmtCommand, NmtState, state_text
from dbc.configuration import Setting
from dbc.contract import Contract, NodeContract
from dbc.dictionary import SILENT_AFTER_S
from gateway.foreign_sdo import GAINS, Effect, ForeignClient
from gateway.grouped_lines import GroupedLines
from gateway.proof import Known, Proof, prove
from gateway.sdo import ATTEMPTS, TIMEOUT_S, Dialogue, SdoDialogue
from gateway.spread import Spread

#: Pause before each attempt to restart a node. After the last attempt, one attempt follows every `LATER_S`; of a node
#: that is heard and answers no question, or boots meanwhile, after the last pause.
PAUSES_S: Final = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0)
LATER_S: Final = 60.0
#: After this long in OPERATIONAL, the next loss begins with the shortest pause.
STABLE_S: Final = 10.0
#: A node is out for this long after frames have come twice with other sums, in cycles at most `TOGETHER_S` apart. After
#: one such cycle it stays: boards may hear one SYNC twice after a bit error.
TWICE_S: Final = 10.0
TOGETHER_S: Final = 1.0
#: On the bus, a heartbeat with the old state may come this much later than the NMT start.
UNDER_WAY_NS: Final = 300_000_000
#: Emergencies of a node that are kept.
HISTORY: Final = 8
#: An emergency at most this long before a node left is logged as the reason.
EXPLAINS_S: Final = 2.0

Send = Callable[[int, bytes], None]
#: Of the table: called with a node, the time, and the reason for the log.
_Action = Callable[["NodeMachine", float, str], None]


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
REFUSED: Final = (NodeState.REFUSED, NodeState.REFUSED_CHECKED)


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
    REPLUGGED = auto()  #: The controller is back on the bus, which may be another.
    TWICE = auto()  #: Another board sends sums with the node-ID.
    OUTDATED = auto()  #: The newest proof is too old.
    WRITTEN = auto()  #: Another master writes the configuration.
    BUSY = auto()  #: Another master uses the SDO channel: a node answers one client at a time.


#: What the loss of a node that was in use is called outside.
_FAULTS: Final = {
    Event.BOOTED: Fault.BOOTED,
    Event.LEFT: Fault.LEFT,
    Event.LOST: Fault.SILENT,
    Event.TWICE: Fault.TWICE,
    Event.REPLUGGED: Fault.UNPROVEN,
    Event.OUTDATED: Fault.UNPROVEN,
    Event.WRITTEN: Fault.CHANGED,
    Event.DIFFERENT: Fault.CHANGED,
}
_STARTING: Final = NodeFault(Fault.STARTING)
_LATE: Final = f", and an answer came after more than {TIMEOUT_S:g} s"
#: A node that was asked in vain this often, and sends heartbeats, does not answer.
_IN_VAIN: Final = 2


@dataclass
class BusOfNodes:
    """What the nodes of one bus share.

    Attributes
    ----------
    contract : Contract
        Of the skin.
    send : callable
        Sends a classic frame: COB-ID and data.
    use : callable
        Called with a node and whether its sums are used from now on.
    writes : bool
        A proof writes objects that differ; else it refuses the node.
    in_steps : bool
        Nodes that run send by themselves: a proof would wait for their sums.
    is_quiet : bool
        All nodes are stopped for a while (`NmtMaster.restart`).
    emergencies : list of (int, int)
        Node-ID and error code, since the list was last cleared.
    recalibrated : list of NodeContract
        Nodes whose gains or offsets have become others since the list was last cleared, and not by the gateway.
    """

    contract: Contract
    send: Send
    use: Callable[[NodeContract, bool], None]
    lines: GroupedLines
    writes: bool
    in_steps: bool
    is_quiet: bool = False
    emergencies: list[tuple[int, int]] = field(default_factory=list)
    recalibrated: list[NodeContract] = field(default_factory=list)

    def command(self, command: NmtCommand, *node_ids: int) -> None:
        """Send an NMT command to each node."""
        for node_id in node_ids:
            self.send(NMT_COB_ID, bytes((command, node_id)))


@dataclass
class NodeMachine:
    """One node: its state, and what it does at each event; times are monotonic seconds.

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
    twice_s, alone_s : float
        When frames came twice with other sums; and when the node may be proven again after that.
    tries : int
        Dialogues since the node was last stable in OPERATIONAL.
    asked : bool
        The first dialogue has ended.
    heard_s, emcy_s, used_since_s, commanded_s, began_s : float
        Times of the newest heartbeat, the newest active emergency, the newest start of use, the gateway's newest NMT
        start, and the beginning of the newest proof.
    due_s : float
        When `tick` has something to do, or a proof is to begin, if nothing happens before.
    refusal : str
        Why the node is refused; empty in the other states.
    unanswered : str
        Why the newest proof that failed has no result.
    dialogue : SdoDialogue or None
        The open proof, in the states `*CHECKED`.
    errand : SdoDialogue or None
        The open dialogue of a node in use about something else: `NmtMaster.ask`.
    hint : str
        The reason that the log gives for the next boot.
    lost_s : float or None
        When the node's sums were given up; None while they are used, or before their first use.
    loss : NodeFault
        Why they were given up.
    is_other_device : bool
        The newest proof has found another identity.
    emergencies : deque of (int, float)
        Its newest error codes, and when they came.
    answer_s, heartbeat_s : Spread
        Times of answers, and between heartbeats.
    """

    bus: BusOfNodes
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
    unanswered: str = ""
    dialogue: SdoDialogue | None = None
    errand: SdoDialogue | None = None
    began_s: float = -np.inf
    prove_at_s: float = 0.0
    due_s: float = -np.inf
    twice_s: float = -np.inf
    alone_s: float = -np.inf
    #: Transfers of the last proof.
    cost: int = 1
    tries: int = 0
    asked: bool = False
    lost_s: float | None = None
    hint: str = ""
    loss: NodeFault = _STARTING
    is_other_device: bool = False
    emergencies: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=HISTORY))
    answer_s: Spread = field(default_factory=Spread)
    heartbeat_s: Spread = field(default_factory=Spread)

    @property
    def fault(self) -> NodeFault | None:
        """Why the node's sums are not used; None if they are."""
        if self.in_use:
            return None
        if self.refusal:
            return NodeFault(Fault.OTHER_DEVICE if self.is_other_device else Fault.REFUSED, self.refusal)
        if self.nmt == SILENT and self.heard_s == -np.inf:
            return NodeFault(Fault.AWAY if self.contract.is_optional else Fault.ABSENT)
        if self.nmt != SILENT and self.tries >= _IN_VAIN and self.loss.kind in {Fault.STARTING, Fault.SILENT}:
            return NodeFault(Fault.UNANSWERED, f"{self.tries} proofs begun in vain{self.unanswered}")
        return self.loss

    @property
    def in_use(self) -> bool:
        """Whether the node's sums are used."""
        return self.state >= NodeState.IN_USE

    @property
    def is_free(self) -> bool:
        """Whether no dialogue with the node is open: it answers one request at a time."""
        return self.dialogue is None and self.errand is None

    # What comes from the bus

    def take_heartbeat(self, state: int, time_ns: int, now_s: float) -> None:
        """Use a heartbeat, or a boot-up message."""
        was_silent = self.nmt == SILENT
        if not was_silent and self.heard_s > -np.inf:
            self.heartbeat_s.add(now_s - self.heard_s, now_s)
        self.heard_s = now_s
        if state == NmtState.INITIALISING:
            self._booted(now_s)
            return
        if state != NmtState.OPERATIONAL and self.in_use:
            is_under_way = self.started_ns is None or time_ns - self.started_ns < UNDER_WAY_NS
            if is_under_way and now_s - self.commanded_s < SILENT_AFTER_S:
                return
            why = f"left OPERATIONAL: {state_text(state)}{self._explanation(now_s)}"
            self.nmt = state
            self._happen(Event.LEFT, now_s, why)
            return
        self.nmt = state
        if self.refusal:
            self.due_s = now_s  # it may run
        if was_silent:
            self._happen(Event.HEARD, now_s)

    def _booted(self, now_s: float) -> None:
        if self.nmt == SILENT or self.refusal or self.hint:  # somebody has worked on the node
            self.tries = 0
        self.foreign.booted()
        why = f"booted again{self.hint or self._explanation(now_s)}"
        self.nmt, self.hint = NmtState.PRE_OPERATIONAL, ""
        self._happen(Event.BOOTED, now_s, why)

    def _explanation(self, now_s: float) -> str:
        """Return the emergency that explains why the node leaves now, empty without one."""
        return f" after EMCY {self.emcy:04X}h" if now_s - self.emcy_s < EXPLAINS_S else ""

    def take_emergency(self, code: int, now_s: float) -> None:
        """Use an emergency; code 0: no error is left."""
        self.emcy = code
        self.emergencies.append((code, now_s))
        self.emcy_s = now_s if code else -np.inf
        if code:
            self.bus.emergencies.append((self.contract.node_id, code))

    def take_answer(self, data: bytes, now_s: float) -> bool:
        """Use an SDO answer; tell whether it belongs to a proof."""
        self.due_s = now_s
        if self.foreign.take_answer(data):
            if (asking := self.dialogue or self.errand) is not None:
                asking.ask_again(data, now_s)
            return False
        if (asking := self.dialogue or self.errand) is not None and self.in_use:  # else a request may have waited
            self.answer_s.add(now_s - asking.requested_s, now_s)
        if self.dialogue is not None:
            self.dialogue.take(data, now_s)
            self._finish(now_s)
            return True
        if self.errand is not None:
            self.errand.take(data, now_s)
            self._end_errand()
        elif not self.in_use and _LATE not in self.unanswered:
            self.unanswered += _LATE
        return False

    def take_foreign_request(self, data: bytes, now_s: float) -> None:
        """Use an SDO request of another master."""
        self.due_s = now_s
        effect = self.foreign.take(data, now_s)
        if effect is Effect.DOUBT:
            self.known.doubt()
            self._happen(Event.WRITTEN, now_s, f"doubted: another master writes its {self.foreign.written}")
        elif effect is Effect.BUSY:
            self.errand = None
            self._happen(Event.BUSY, now_s)

    def take_foreign_command(self, command: int, now_s: float) -> None:
        """Use an NMT command of another master."""
        if command in COMMANDED and command != NmtCommand.START and self.nmt != SILENT:
            self.nmt = COMMANDED[NmtCommand(command)]
            why = f"left OPERATIONAL: {state_text(self.nmt)}, by another master's NMT command"
            self._happen(Event.LEFT, now_s, why)
        elif command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            self.hint = ", reset by another master"

    def take_twice(self, now_s: float) -> None:
        """Take note that frames of a cycle have come twice with other sums: those of two boards."""
        is_again, self.twice_s = now_s - self.twice_s <= TOGETHER_S, now_s
        if is_again:
            self.due_s = now_s
            is_new, self.alone_s = now_s >= self.alone_s, now_s + TWICE_S
            if is_new:
                self._happen(Event.TWICE, now_s, "is there twice: its sums come twice, and differ")

    # What the master wants

    def tick(self, limit_s: float, now_s: float) -> None:
        """Check times; a proof holds for `limit_s`."""
        if self.dialogue is not None:
            self.dialogue.tick(now_s)
            self._finish(now_s)
        self._check_times(limit_s, now_s)
        if self.errand is not None:
            self.errand.tick(now_s)
            self._end_errand()
        self._find_due(limit_s)

    def _find_due(self, limit_s: float) -> None:
        due_s = [each.due_s for each in (self.dialogue, self.errand) if each is not None]
        if self.dialogue is None:
            due_s.append(max(self.prove_at_s, self.alone_s, self.foreign.free_s))
        if self.nmt != SILENT:
            due_s.append(self.heard_s + SILENT_AFTER_S)
        if self.in_use:
            due_s.append(self.proven_s + limit_s)
        if self.in_use and self.tries:
            due_s.append(self.used_since_s + STABLE_S)
        self.due_s = min(due_s)

    def ask(self, steps: Dialogue, now_s: float) -> SdoDialogue | None:
        """Begin a dialogue with a node in use, one attempt for each transfer; None while its SDO channel is busy."""
        if not self.in_use or not self.is_free or now_s < self.foreign.free_s:
            return None
        self.errand, self.due_s = self._dialogue(steps, now_s, attempts=1), now_s
        return self.errand

    def take_replugged(self, now_s: float) -> None:
        """Prove the node before its sums are used again: the controller is back, maybe on another bus."""
        self._happen(Event.REPLUGGED, now_s, "not proven since the controller is back on the bus")

    def begin_proof(self, now_s: float) -> None:
        """Prove the node: its time has come."""
        self._happen(Event.DUE, now_s)

    def expect_start(self, now_s: float) -> None:
        """Ignore other states until the node's start command was on the bus."""
        self.due_s = now_s
        self.started_ns, self.commanded_s = None, now_s
        self.nmt, self.heard_s = NmtState.OPERATIONAL, now_s

    def _dialogue(self, steps: Dialogue, now_s: float, *, attempts: int) -> SdoDialogue:
        def send(can_id: int, data: bytes) -> None:
            self.foreign.ask(data)
            self.bus.send(can_id, data)

        return SdoDialogue(self.contract.node_id, steps, send, now_s, attempts=attempts)

    def _end_errand(self) -> None:
        if self.errand is not None and self.errand.done:
            self.errand = None

    def _check_times(self, limit_s: float, now_s: float) -> None:
        """Find a heartbeat or a proof that is overdue, and a refused node that sends PDOs."""
        if self.nmt != SILENT and now_s - self.heard_s > SILENT_AFTER_S:
            self.nmt = SILENT
            self._happen(Event.LOST, now_s, f"silent: no heartbeat for {SILENT_AFTER_S:g} s")
        if self.refusal and self.nmt == NmtState.OPERATIONAL:
            self._happen(Event.RUNNING, now_s)
        if self.tries and self.in_use and now_s - self.used_since_s > STABLE_S:
            self.tries = 0
        if now_s - self.proven_s > limit_s and self.in_use:
            self._happen(Event.OUTDATED, now_s, f"not proven for {now_s - self.proven_s:.0f} s")

    def _finish(self, now_s: float) -> None:
        """Act on the result of a proof that has ended."""
        dialogue = self.dialogue
        if dialogue is None or not dialogue.done:
            return
        self.asked = True
        proof = dialogue.result
        if not isinstance(proof, Proof):
            self.unanswered = f": {dialogue.error}"
            self._happen(Event.UNANSWERED, now_s)
            return
        self.cost, self.is_other_device = proof.cost, proof.is_other_device
        if proof.written:
            self._log(f"set right: {proof.written}", now_s)
        if proof.refusal:
            self._happen(Event.WRONG, now_s, proof.told(self.bus.contract))
            return
        if self.known.take(proof.gains):
            self.bus.recalibrated.append(self.contract)
            doubt = ", and its forces are doubtful until 'skin tare'" if self.known.is_doubtful else ""
            self._log(f"{GAINS} have changed: its zero counts no longer{doubt}", now_s)
        # A proof holds from its oldest read.
        self.proven_s = dialogue.asked_s if proof.is_one_read else self.began_s
        self._happen(Event.RIGHT, now_s)

    def _happen(self, event: Event, now_s: float, why: str = "") -> None:
        """Do what `TRANSITIONS` says; `why` is for the log."""
        found = self.TRANSITIONS[self.state].get(event)
        if found is None:
            return
        act, self.state = found
        self.due_s = now_s
        if act in {NodeMachine._stop_using, NodeMachine._tell}:
            is_away = self.contract.is_optional and event is Event.LOST
            self.loss = NodeFault(Fault.AWAY if is_away else _FAULTS[event], why)
        if self.state not in _CHECKED:
            self.dialogue = None
        if self.state not in REFUSED:
            self.refusal = ""
        act(self, now_s, why)

    def _log(self, text: str, now_s: float) -> None:
        self.bus.lines.add(self.contract.node_id, text, now_s)

    def _command(self, command: NmtCommand) -> None:
        self.bus.command(command, self.contract.node_id)

    # The actions of the table

    def _start_using(self, now_s: float, _why: str) -> None:
        """Use the sums of a proven node and start it; attempts before its first start are not counted."""
        self.used_since_s, self.prove_at_s, self.hint = now_s, np.inf, ""
        self.bus.use(self.contract, True)
        if self.bus.is_quiet or self.nmt != NmtState.OPERATIONAL:
            self.expect_start(now_s)
            if not self.bus.is_quiet:
                self._command(NmtCommand.START)
        if self.lost_s is not None:
            self._log(f"back after {now_s - self.lost_s:.1f} s", now_s)
            self.lost_s = None
        else:
            self.tries = 0  # the first start, not a restart

    def _stop_using(self, now_s: float, why: str) -> None:
        """Use no more sums of a node; try to restart it after a pause."""
        self.errand = None
        self.bus.use(self.contract, False)
        if self.lost_s is None:
            self.lost_s = now_s
        self._tell(now_s, why)
        self._pause(now_s, why)

    def _tell(self, now_s: float, why: str) -> None:
        """Tell why the sums of a node are not used."""
        self._log(f"{why} [{self.loss.code}]", now_s)

    def _prove(self, now_s: float, _why: str) -> None:
        """Begin a proof."""

        def doubt(why: str) -> None:
            self._happen(Event.DIFFERENT, now_s, why)

        self.began_s = now_s
        steps = prove(self.settings, self.signature, self.known, write=self.bus.writes, in_use=self.in_use, doubt=doubt)
        # One attempt for a silent node: the boot-up message or heartbeat tells when the node is there.
        attempts = 1 if self.nmt == SILENT else ATTEMPTS
        self.dialogue = self._dialogue(steps, now_s, attempts=attempts)

    def _try(self, now_s: float, why: str) -> None:
        """Begin to prove a node that is not in use."""
        # A stopped node answers no SDO (CiA 301, 7.3.2.2.4), and a node without heartbeat may be stopped. A stepped
        # node may also run: it sends all its sums only when it starts.
        may_be_stopped = self.nmt == SILENT and (self.tries > 0 or self.bus.in_steps) and not self.bus.is_quiet
        if self.nmt == NmtState.STOPPED or may_be_stopped:
            self._command(NmtCommand.ENTER_PRE_OPERATIONAL)
        self.tries += 1
        self._prove(now_s, why)

    def _refuse(self, now_s: float, why: str) -> None:
        """Tell why; try again later."""
        if why != self.refusal:
            kind = Fault.OTHER_DEVICE if self.is_other_device else Fault.REFUSED
            self._log(f"refused: {why} [{NodeFault(kind).code}]", now_s)
        self.refusal, self.prove_at_s = why, now_s + LATER_S

    def _halt(self, _now_s: float, _why: str) -> None:
        """End the PDOs of a refused node: they may have identifiers of other nodes."""
        self._command(NmtCommand.ENTER_PRE_OPERATIONAL)
        self.nmt = NmtState.PRE_OPERATIONAL

    def _pause(self, now_s: float, _why: str, later_s: float = LATER_S) -> None:
        """Set the time of the next try."""
        is_over = self.tries >= len(PAUSES_S)
        self.prove_at_s = now_s + (later_s if is_over else PAUSES_S[self.tries])
        if self.tries == len(PAUSES_S) and self.nmt != SILENT:
            self._log(f"given up after {len(PAUSES_S)} tries: tried again every {later_s:g} s", now_s)

    def _pause_briefly(self, now_s: float, why: str) -> None:
        """Set the time of the next try: soon for a node that was not started, and is heard."""
        self._pause(now_s, why, LATER_S if self.nmt == SILENT else PAUSES_S[-1])

    def _pause_if_lost(self, now_s: float, why: str) -> None:
        """Set the time of the next try: now for a node that was never in use."""
        if self.lost_s is None:
            self.prove_at_s = now_s
        else:
            self._pause_briefly(now_s, why)

    def _try_now(self, now_s: float, _why: str) -> None:
        """Begin the tries anew."""
        self.tries = 0
        self.prove_at_s = min(self.prove_at_s, now_s)

    def _try_when_free(self, _now_s: float, _why: str) -> None:
        """Try again as soon as the other master leaves the SDO channel alone."""
        self.prove_at_s = self.foreign.free_s

    def _give_way(self, _now_s: float, _why: str) -> None:
        """Begin the proof again when the SDO channel is free; a node in use keeps its turn."""
        self.began_s = self.proven_s
        self.prove_at_s = max(self.prove_at_s, self.foreign.free_s)

    def _go_on(self, now_s: float, why: str) -> None:
        """Do nothing."""

    #: By state and event: the action, and the next state. In a state that does not list an event, it changes nothing.
    TRANSITIONS: ClassVar[dict[NodeState, dict[Event, tuple[_Action, NodeState]]]] = {
        NodeState.WAITING: {
            Event.DUE: (_try, NodeState.CHECKED),
            Event.REPLUGGED: (_try_now, NodeState.WAITING),
            Event.TWICE: (_tell, NodeState.WAITING),
            Event.BOOTED: (_pause_if_lost, NodeState.WAITING),
            Event.HEARD: (_try_now, NodeState.WAITING),
            Event.WRITTEN: (_give_way, NodeState.WAITING),
        },
        NodeState.CHECKED: {
            Event.RIGHT: (_start_using, NodeState.IN_USE),
            Event.WRONG: (_refuse, NodeState.REFUSED),
            Event.UNANSWERED: (_pause_briefly, NodeState.WAITING),
            Event.REPLUGGED: (_try_now, NodeState.WAITING),
            Event.TWICE: (_tell, NodeState.WAITING),
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
            Event.REPLUGGED: (_try_now, NodeState.REFUSED),
            Event.WRITTEN: (_try_when_free, NodeState.REFUSED),
        },
        NodeState.REFUSED_CHECKED: {
            Event.RIGHT: (_start_using, NodeState.IN_USE),
            Event.WRONG: (_refuse, NodeState.REFUSED),
            Event.UNANSWERED: (_pause_briefly, NodeState.REFUSED),
            Event.BOOTED: (_pause_if_lost, NodeState.WAITING),
            Event.HEARD: (_try_now, NodeState.REFUSED_CHECKED),
            Event.RUNNING: (_halt, NodeState.REFUSED_CHECKED),
            Event.LOST: (_go_on, NodeState.CHECKED),
            Event.REPLUGGED: (_try_now, NodeState.REFUSED),
            Event.WRITTEN: (_try_when_free, NodeState.REFUSED),
            Event.BUSY: (_give_way, NodeState.REFUSED),
        },
        NodeState.IN_USE: {
            Event.DUE: (_prove, NodeState.IN_USE_CHECKED),
            Event.BOOTED: (_stop_using, NodeState.WAITING),
            Event.LEFT: (_stop_using, NodeState.WAITING),
            Event.LOST: (_stop_using, NodeState.WAITING),
            Event.REPLUGGED: (_stop_using, NodeState.WAITING),
            Event.TWICE: (_stop_using, NodeState.WAITING),
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
            Event.REPLUGGED: (_stop_using, NodeState.WAITING),
            Event.TWICE: (_stop_using, NodeState.WAITING),
            Event.OUTDATED: (_stop_using, NodeState.CHECKED),
            Event.WRITTEN: (_stop_using, NodeState.WAITING),
            Event.BUSY: (_give_way, NodeState.IN_USE),
        },
    }
