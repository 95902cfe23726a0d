"""The NMT master of one bus: proves each node's configuration, starts the node, and restarts lost nodes.

After CiA 302-2, boot NMT slave and error control. Time and frames are arguments; no function waits.
"""

from collections.abc import Callable
from typing import Final

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
    TPDO_BASES,
    NmtCommand,
    NmtState,
    is_of_node,
)
from dbc.configuration import PROOF_ROUNDS, configuration, expected_signature, proof_period_s
from dbc.contract import Contract, NodeContract
from dbc.dictionary import SILENT_AFTER_S
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames
from gateway.foreign_sdo import Effect, ForeignClient
from gateway.grouped_lines import GroupedLines
from gateway.node_record import NodeRecord, state_text
from gateway.proof import Proof, prove
from gateway.sdo import ATTEMPTS, TIMEOUT_S, Dialogue, SdoDialogue

#: Pause before each attempt to restart a node. After the last attempt, one attempt follows every `LATER_S`.
PAUSES_S: Final = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0)
LATER_S: Final = 60.0
#: After this long in OPERATIONAL, the next loss begins with the shortest pause.
STABLE_S: Final = 10.0
#: On the bus, a heartbeat with the old state may come this much later than the NMT start.
UNDER_WAY_NS: Final = 300_000_000
#: Most SDO dialogues at the same time. SDO frames have a lower priority than TPDOs.
DIALOGUES: Final = 16
#: How often `tick` looks at every node.
TICK_S: Final = 0.01

Send = Callable[[int, bytes], None]


class NmtMaster:
    """NMT master of the nodes of one bus.

    Parameters
    ----------
    contract : Contract
    bus : int
        Number of the bus in the layout.
    send : callable
        Sends a classic frame: COB-ID and data.
    trust : callable
        Called with a node and whether its sums may be used.
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
        trust: Callable[[NodeContract, bool], None],
        say: Callable[[str], None],
    ) -> None:
        self._name = contract.layout.bus[bus].name
        self._write = contract.layout.configure == "write"
        self._send = send
        self._trust = trust
        self.nodes = {
            node.node_id: NodeRecord(
                node, settings, expected_signature(settings), ForeignClient({each.index for each in settings})
            )
            for node in contract.on_bus(bus)
            for settings in [configuration(contract, node)]
        }
        self.node_ids = list(self.nodes)
        self._round_s = proof_period_s(contract, bus)
        self._slot_s = self._tick_s = -np.inf
        self._lines = GroupedLines(self._name, say)
        #: Emergencies since the list was last cleared: node-ID and error code.
        self.emergencies: list[tuple[int, int]] = []

    @property
    def passed(self) -> bool:
        """Whether every node's first dialogue has ended, with or without an answer."""
        return all(node.asked for node in self.nodes.values())

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
        return [node_id for node_id, node in self.nodes.items() if node.refusal]

    @property
    def awaited(self) -> list[int]:
        """Node-IDs neither proven nor refused; in most cases the node is absent."""
        return [node_id for node_id, node in self.nodes.items() if not node.trusted and not node.refusal]

    @property
    def proof_limit_s(self) -> float:
        """How long a block stays valid after the last proof of its node."""
        nodes = self.nodes.values()
        mean_cost = sum(node.cost for node in nodes) / len(nodes)
        return PROOF_ROUNDS * self._round_s * mean_cost + ATTEMPTS * TIMEOUT_S

    # What arrives

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use the frames of the bus, in bus order."""
        can_id, flags = arrived["can_id"], arrived["flags"]
        if not ((can_id < TPDO_BASES[0]) | (can_id > SDO_RESPONSE_BASE)).any():
            return  # sums only
        plain = flags & (ERROR | ECHO | EXTENDED | REMOTE) == 0
        ours = (can_id == NMT_COB_ID) | (can_id > SDO_RESPONSE_BASE) | is_of_node(can_id, EMCY_BASE)
        commanded = (flags & (ERROR | ECHO) == ECHO) & (can_id == NMT_COB_ID)
        for frame in arrived[plain & ours | commanded]:
            identifier, time_ns = int(frame["can_id"]), int(frame["time_ns"])
            node = self.nodes.get(identifier & HIGHEST_NODE_ID)
            data = frame["data"][: frame["length"]].tobytes()
            if identifier == NMT_COB_ID and len(data) == NMT_BYTES:
                if not frame["flags"] & ECHO:
                    self._foreign_nmt(data[0], data[1], now_s)
                elif data[0] == NmtCommand.START and data[1] in self.nodes:
                    self.nodes[data[1]].started_ns = time_ns
            elif node is not None:
                base = identifier & ~HIGHEST_NODE_ID
                if base == HEARTBEAT_BASE and len(data) == HEARTBEAT_BYTES:
                    self._heartbeat(node, data[0] & 0x7F, time_ns, now_s)
                else:
                    self._take_of(node, base, data, now_s)

    def _take_of(self, node: NodeRecord, base: int, data: bytes, now_s: float) -> None:
        if base == SDO_RESPONSE_BASE and len(data) == SDO_BYTES:
            node.foreign.take_answer(data)
            if node.dialogue is not None:
                node.dialogue.take(data, now_s)
                self._finish(node, now_s)
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
            if was_silent:
                node.tries = 0
            node.nmt = NmtState.PRE_OPERATIONAL
            self._booted(node, now_s)
            return
        if state != NmtState.OPERATIONAL and node.trusted:
            is_under_way = node.started_ns is None or time_ns - node.started_ns < UNDER_WAY_NS
            if is_under_way and now_s - node.trusted_s < SILENT_AFTER_S:
                return
            node.nmt = state
            self._stop_using(node, f"left OPERATIONAL: {state_text(state)}{node.explanation(now_s)}", now_s)
            return
        node.nmt = state
        if was_silent and not node.trusted:
            node.tries = 0
            node.prove_at_s = min(node.prove_at_s, now_s)

    def _booted(self, node: NodeRecord, now_s: float) -> None:
        """Use no sums of a node that has booted until the node is proven again."""
        node.dialogue = node.errand = None
        if node.refusal or node.hint:  # somebody has worked on the node
            node.tries = 0
        node.refusal = ""
        if node.trusted:
            self._stop_using(node, f"booted again{node.hint or node.explanation(now_s)}", now_s)
        elif node.lost_s is None:
            node.prove_at_s = now_s
        else:
            self._pause(node, now_s)
        node.hint = ""

    def _foreign_nmt(self, command: int, node_id: int, now_s: float) -> None:
        nodes = self.nodes.values() if node_id == 0 else filter(None, [self.nodes.get(node_id)])
        for node in nodes:
            if command in COMMANDED and command != NmtCommand.START and node.nmt != SILENT:
                node.nmt = COMMANDED[NmtCommand(command)]
                if node.trusted:
                    state = state_text(node.nmt)
                    self._stop_using(node, f"left OPERATIONAL: {state}, by another master's NMT command", now_s)
            elif command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
                node.hint = ", reset by another master"

    def _foreign_sdo(self, node: NodeRecord, data: bytes, now_s: float) -> None:
        """Use no sums of a node whose configuration somebody else writes until the node is proven again."""
        effect = node.foreign.take(data, now_s)
        if effect is Effect.DOUBT:
            self._doubt_written(node, now_s)
        elif effect is Effect.BUSY:
            node.errand = None
            if node.dialogue is not None:
                node.dialogue, node.began_s = None, node.proven_s
                node.prove_at_s = max(node.prove_at_s, node.foreign.free_s)

    def _doubt_written(self, node: NodeRecord, now_s: float) -> None:
        node.dialogue = None
        if node.trusted:
            self._stop_using(node, "doubted: another master writes its configuration", now_s)
        elif node.refusal:
            node.prove_at_s = now_s
        node.prove_at_s = max(node.prove_at_s, node.foreign.free_s)

    def swapped(self, node_id: int, now_s: float) -> None:
        """Reset the communication of a node that answers every SYNC with the PDOs of the other phase."""
        node = self.nodes[node_id]
        if node.trusted:
            why = "answers SYNC with the PDOs of the other phase, or a cycle late: communication reset"
            self._stop_using(node, why, now_s)
            self._command(NmtCommand.RESET_COMMUNICATION, node_id)

    # What time calls for

    def tick(self, now_s: float) -> None:
        """Check times, begin dialogues, and start proven nodes; call it many times a second."""
        if now_s < self._tick_s:
            return
        self._tick_s = now_s + TICK_S
        limit_s = self.proof_limit_s
        for node in self.nodes.values():
            if node.dialogue is not None:
                node.dialogue.tick(now_s)
                self._finish(node, now_s)
            self._check_times(node, limit_s, now_s)
            if node.errand is not None:
                node.errand.tick(now_s)
                node.end_errand()
        free = DIALOGUES - sum(node.dialogue is not None for node in self.nodes.values())
        out = [node for node in self.nodes.values() if not node.trusted and node.dialogue is None]
        due = sorted((node for node in out if now_s >= node.prove_at_s), key=lambda node: node.prove_at_s)
        for node in due[: max(0, free)]:
            self._bring_back(node, now_s)
        self._prove_in_turn(now_s)
        self._lines.tick(now_s)

    def ask(self, node_id: int, steps: Dialogue, now_s: float) -> SdoDialogue | None:
        """Begin a dialogue with a node in use, one attempt for each transfer; None while its SDO channel is busy."""
        node = self.nodes[node_id]
        if not node.trusted or not node.is_free or now_s < node.foreign.free_s:
            return None
        node.errand = SdoDialogue(node_id, steps, self._send, now_s, attempts=1)
        return node.errand

    def stop(self) -> None:
        """Command all nodes to PRE-OPERATIONAL."""
        self._command(NmtCommand.ENTER_PRE_OPERATIONAL, 0)
        self._lines.flush()

    def _check_times(self, node: NodeRecord, limit_s: float, now_s: float) -> None:
        """Find a heartbeat or a proof that is overdue, and a refused node that sends PDOs."""
        if node.nmt != SILENT and now_s - node.heard_s > SILENT_AFTER_S:
            node.nmt, node.refusal = SILENT, ""
            if node.trusted:
                self._stop_using(node, f"silent: no heartbeat for {SILENT_AFTER_S:g} s", now_s)
        if node.refusal and node.nmt == NmtState.OPERATIONAL:
            # Its PDOs may have identifiers of other nodes.
            self._command(NmtCommand.ENTER_PRE_OPERATIONAL, node.contract.node_id)
            node.nmt = NmtState.PRE_OPERATIONAL
        if node.trusted and now_s - node.trusted_s > STABLE_S:
            node.tries = 0
        if node.trusted and now_s - node.proven_s > limit_s:
            self._stop_using(node, f"not proven for {now_s - node.proven_s:.0f} s", now_s)

    def _bring_back(self, node: NodeRecord, now_s: float) -> None:
        """Begin to prove a node that is not in use; the node is started when the proof succeeds."""
        # A stopped node answers no SDO (CiA 301, 7.3.2.2.4), and a node without heartbeat may be stopped.
        if node.nmt == NmtState.STOPPED or (node.nmt == SILENT and node.tries):
            self._command(NmtCommand.ENTER_PRE_OPERATIONAL, node.contract.node_id)
        node.tries += 1
        self._begin(node, now_s)

    def _prove_in_turn(self, now_s: float) -> None:
        """Prove the node whose proof is oldest, as often as the share of the bus for proofs allows."""
        if now_s < self._slot_s:
            return
        share_s = self._round_s / len(self.nodes)
        self._slot_s = max(self._slot_s, now_s - share_s) + share_s
        waiting = [node for node in self.nodes.values() if node.trusted and node.is_free]
        oldest = min(waiting, key=lambda node: node.began_s, default=None)
        if oldest is None:
            return
        if now_s < oldest.foreign.free_s and now_s - oldest.began_s < self._round_s * oldest.cost:
            return
        self._slot_s += (oldest.cost - 1) * share_s
        self._begin(oldest, now_s)

    def _begin(self, node: NodeRecord, now_s: float) -> None:
        def doubt() -> None:
            if node.trusted:
                self._stop_using(node, "doubted: its configuration is not that of the layout", now_s)

        node.began_s = now_s
        steps = prove(node.settings, node.signature, write=self._write, doubt=doubt)
        # One attempt for a silent node: the boot-up message or heartbeat tells when the node is there.
        attempts = 1 if node.nmt == SILENT else ATTEMPTS
        node.dialogue = SdoDialogue(node.contract.node_id, steps, self._send, now_s, attempts=attempts)

    def _finish(self, node: NodeRecord, now_s: float) -> None:
        """Act on the result of a dialogue that has ended."""
        dialogue = node.dialogue
        if dialogue is None or not dialogue.done:
            return
        node.dialogue, node.asked = None, True
        proof = dialogue.result
        if not isinstance(proof, Proof):
            if not node.trusted:
                self._pause(node, now_s)
            return
        node.cost = 1 if proof.has_signature else len(node.settings) + 1
        if proof.written:
            self._lines.add(node.contract.node_id, f"set right: {proof.written}", now_s)
        if proof.refusal:
            if proof.refusal != node.refusal:
                self._lines.add(node.contract.node_id, f"refused: {proof.refusal}", now_s)
            node.refusal, node.prove_at_s = proof.refusal, now_s + LATER_S
            return
        # A proof holds from its oldest read: with a signature the last transfer, without one the first.
        node.refusal, node.proven_s = "", dialogue.asked_s if proof.has_signature else node.began_s
        if not node.trusted:
            self._start_using(node, now_s)

    def _start_using(self, node: NodeRecord, now_s: float) -> None:
        """Use the sums of a proven node and start it; attempts before its first start are not counted."""
        node.trusted, node.trusted_s, node.hint = True, now_s, ""
        self._trust(node.contract, True)
        if node.nmt != NmtState.OPERATIONAL:
            node.started_ns = None
            self._command(NmtCommand.START, node.contract.node_id)
            node.nmt, node.heard_s = NmtState.OPERATIONAL, now_s
        if node.lost_s is not None:
            self._lines.add(node.contract.node_id, f"back after {now_s - node.lost_s:.1f} s", now_s)
            node.lost_s = None
        else:
            node.tries = 0  # the first start, not a restart

    def _stop_using(self, node: NodeRecord, why: str, now_s: float) -> None:
        """Use no more sums of a node; try to restart it after a pause."""
        node.trusted, node.errand = False, None
        self._trust(node.contract, False)
        if node.lost_s is None:
            node.lost_s = now_s
        self._lines.add(node.contract.node_id, why, now_s)
        self._pause(node, now_s)

    def _pause(self, node: NodeRecord, now_s: float) -> None:
        """Set the time of the next attempt for a node that is not in use."""
        is_over = node.tries >= len(PAUSES_S)
        node.prove_at_s = now_s + (LATER_S if is_over else PAUSES_S[node.tries])
        if node.tries == len(PAUSES_S) and node.nmt != SILENT:
            self._lines.add(
                node.contract.node_id, f"given up after {len(PAUSES_S)} tries: tried again every {LATER_S:g} s", now_s
            )

    def _command(self, command: NmtCommand, node_id: int) -> None:
        self._send(NMT_COB_ID, bytes((command, node_id)))
