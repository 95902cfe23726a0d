"""The NMT master of one bus: proves what every node sends, starts it, and brings it back when it leaves OPERATIONAL.

After CiA 302-2, boot NMT slave and error control. Time and frames are arguments, so that nothing here waits.
"""

from collections.abc import Callable
from typing import Final

import numpy as np
import numpy.typing as npt

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
    is_of_node,
)
from dbc.configuration import PROOF_ROUNDS, configuration, proof_period_s
from dbc.contract import Contract, NodeContract
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames
from gateway.grouped_lines import GroupedLines
from gateway.node_record import NodeRecord
from gateway.proof import Proof, prove
from gateway.sdo import ATTEMPTS, TIMEOUT_S, SdoDialogue
from skin.messages import SILENT

#: A node is silent when its heartbeat is missing for this many periods.
PATIENCE: Final = 1.5
SILENT_AFTER_S: Final = PATIENCE * HEARTBEAT_MS / 1000
#: Pause before each try to bring a node back; a node that is still out after the last is asked once every `LATER_S`.
PAUSES_S: Final = (0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0)
LATER_S: Final = 60.0
#: A node that stays in for this long starts again with the shortest pause.
STABLE_S: Final = 10.0
#: A heartbeat that was on its way when the node was started may come this much later.
UNDER_WAY_S: Final = 0.3
#: The SDO channel of a node has to be quiet for this long before the gateway uses it after somebody else.
SDO_QUIET_S: Final = 0.05
#: A block download of another master goes on while its frames are this close.
BLOCK_DOWNLOAD_S: Final = 1.0
#: Dialogues at the same time; their frames come behind those of the sums.
DIALOGUES: Final = 16
#: An emergency explains why a node left when it came at most this long before.
EXPLAINS_S: Final = 2.0
#: How often `tick` looks at every node.
TICK_S: Final = 0.01

Send = Callable[[int, bytes], None]


class NmtMaster:
    """Looks after the nodes of one bus.

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
        Takes a line for the log.

    Attributes
    ----------
    node_ids : list of int
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
        self._nodes = {
            node.node_id: NodeRecord(node, settings, frozenset(each.index for each in settings))
            for node in contract.on_bus(bus)
            for settings in [configuration(contract, node)]
        }
        self.node_ids = list(self._nodes)
        self._round_s = proof_period_s(contract, bus)
        self._slot_s = self._tick_s = -np.inf
        self._lines = GroupedLines(self._name, say)
        #: Emergencies since the last look: node-ID and error code.
        self.emergencies: list[tuple[int, int]] = []

    # What is known

    @property
    def passed(self) -> bool:
        """Whether every node has been asked once and has answered or not."""
        return all(node.asked for node in self._nodes.values())

    @property
    def nmt(self) -> npt.NDArray[np.uint8]:
        """NMT state of every node by its last heartbeat, `SILENT` when that is overdue; shape (nodes,)."""
        return np.array([node.nmt for node in self._nodes.values()], np.uint8)

    @property
    def emcy(self) -> list[int]:
        """Error code of the newest emergency of every node, 0 for none."""
        return [node.emcy for node in self._nodes.values()]

    @property
    def refused(self) -> list[int]:
        """Node-IDs that are there and must not be used."""
        return [node_id for node_id, node in self._nodes.items() if node.refusal]

    @property
    def awaited(self) -> list[int]:
        """Node-IDs of which nothing is proven and nothing refused: most often they are not there."""
        return [node_id for node_id, node in self._nodes.items() if not node.trusted and not node.refusal]

    @property
    def proof_limit_s(self) -> float:
        """How long a block may stay valid after its node was proven last."""
        nodes = self._nodes.values()
        mean_cost = sum(node.cost for node in nodes) / len(nodes)
        return PROOF_ROUNDS * self._round_s * mean_cost + ATTEMPTS * TIMEOUT_S

    # What arrives

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use frames seen on the bus, in their order."""
        can_id, flags = arrived["can_id"], arrived["flags"]
        plain = flags & (ERROR | ECHO | EXTENDED | REMOTE) == 0
        ours = (can_id == NMT_COB_ID) | (can_id > SDO_RESPONSE_BASE) | is_of_node(can_id, EMCY_BASE)
        for frame in arrived[plain & ours]:
            identifier = int(frame["can_id"])
            node = self._nodes.get(identifier & HIGHEST_NODE_ID)
            data = frame["data"][: frame["length"]].tobytes()
            if identifier == NMT_COB_ID:
                if len(data) == NMT_BYTES:
                    self._foreign_nmt(data[0], data[1], now_s)
            elif node is not None:
                self._take_of(node, identifier & ~HIGHEST_NODE_ID, data, now_s)

    def _take_of(self, node: NodeRecord, base: int, data: bytes, now_s: float) -> None:
        if base == HEARTBEAT_BASE and len(data) == HEARTBEAT_BYTES:
            self._heartbeat(node, data[0] & 0x7F, now_s)
        elif base == SDO_RESPONSE_BASE and len(data) == SDO_BYTES:
            if node.dialogue is not None:
                node.dialogue.take(data, now_s)
                self._finish(node, now_s)
        elif base == SDO_REQUEST_BASE and len(data) == SDO_BYTES:
            self._foreign_sdo(node, data, now_s)
        elif base == EMCY_BASE and len(data) == EMCY_BYTES:
            node.emcy = int.from_bytes(data[:2], "little")
            node.emcy_s = now_s if node.emcy else -np.inf
            if node.emcy:
                self.emergencies.append((node.contract.node_id, node.emcy))

    def _heartbeat(self, node: NodeRecord, state: int, now_s: float) -> None:
        was_silent = node.nmt == SILENT
        node.heard_s = now_s
        if state == NmtState.INITIALISING:
            if was_silent:
                node.tries = 0
            node.nmt = NmtState.PRE_OPERATIONAL
            self._booted(node, now_s)
            return
        if state != NmtState.OPERATIONAL and node.trusted:
            if now_s - node.trusted_s < UNDER_WAY_S:
                return
            node.nmt = state
            self._lose(node, f"left OPERATIONAL: {_state_text(state)}{self._explanation(node, now_s)}", now_s)
            return
        node.nmt = state
        if was_silent and not node.trusted:
            node.tries = 0
            node.prove_at_s = min(node.prove_at_s, now_s)

    def _booted(self, node: NodeRecord, now_s: float) -> None:
        """Doubt a node that has booted: nothing is known of it until it is proven."""
        node.dialogue = None
        if node.refusal or node.hint:  # somebody has looked after it
            node.tries = 0
        node.refusal = ""
        if node.trusted:
            self._lose(node, f"booted again{node.hint or self._explanation(node, now_s)}", now_s)
        elif node.lost_s is None:
            node.prove_at_s = now_s
        else:
            self._pause(node, now_s)
        node.hint = ""

    def _foreign_nmt(self, command: int, node_id: int, now_s: float) -> None:
        nodes = self._nodes.values() if node_id == 0 else filter(None, [self._nodes.get(node_id)])
        for node in nodes:
            if command in COMMANDED and command != NmtCommand.START and node.nmt != SILENT:
                node.nmt = COMMANDED[NmtCommand(command)]
                if node.trusted:
                    self._lose(
                        node, f"left OPERATIONAL: {_state_text(node.nmt)}, by another master's NMT command", now_s
                    )
            elif command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
                node.hint = ", reset by another master"

    def _foreign_sdo(self, node: NodeRecord, data: bytes, now_s: float) -> None:
        """Doubt a node whose configuration somebody else writes, until it is proven again."""
        kind = data[0] >> 5
        if node.in_block_download and now_s - node.foreign_sdo_s < BLOCK_DOWNLOAD_S:
            kind = 0  # the data of a block download: its first byte is a number
        else:
            node.in_block_download = kind == 6
        node.foreign_sdo_s = now_s
        if kind in (1, 6):  # a download begins, in segments or blocks
            node.is_sdo_suspect = int.from_bytes(data[1:3], "little") in node.compared
        if kind in (0, 1, 6) and node.is_sdo_suspect:
            self._doubt_written(node, now_s)
        elif kind and node.dialogue is not None:  # the node answers one client at a time
            node.dialogue, node.began_s = None, node.proven_s
            node.prove_at_s = max(node.prove_at_s, now_s + SDO_QUIET_S)

    def _doubt_written(self, node: NodeRecord, now_s: float) -> None:
        node.dialogue = None
        if node.trusted:
            self._lose(node, "doubted: another master writes its configuration", now_s)
        elif node.refusal:
            node.prove_at_s = now_s
        node.prove_at_s = max(node.prove_at_s, now_s + SDO_QUIET_S)

    def swapped(self, node_id: int, now_s: float) -> None:
        """Reset the communication of a node that answers every SYNC with the PDOs of the other phase."""
        node = self._nodes[node_id]
        if node.trusted:
            self._lose(
                node, "answers SYNC with the PDOs of the other phase, or a cycle late: communication reset", now_s
            )
            self._command(NmtCommand.RESET_COMMUNICATION, node_id)

    # What time calls for

    def tick(self, now_s: float) -> None:
        """Ask, start and give up nodes; call it many times a second."""
        if now_s < self._tick_s:
            return
        self._tick_s = now_s + TICK_S
        limit_s = self.proof_limit_s
        for node in self._nodes.values():
            if node.dialogue is not None:
                node.dialogue.tick(now_s)
                self._finish(node, now_s)
            self._check_times(node, limit_s, now_s)
        free = DIALOGUES - sum(node.dialogue is not None for node in self._nodes.values())
        out = [node for node in self._nodes.values() if not node.trusted and node.dialogue is None]
        due = sorted((node for node in out if now_s >= node.prove_at_s), key=lambda node: node.prove_at_s)
        for node in due[: max(0, free)]:
            self._bring_back(node, now_s)
        self._prove_in_turn(now_s)
        self._lines.tick(now_s)

    def stop(self) -> None:
        """Leave all nodes PRE-OPERATIONAL."""
        self._command(NmtCommand.ENTER_PRE_OPERATIONAL, 0)
        self._lines.flush()

    def _check_times(self, node: NodeRecord, limit_s: float, now_s: float) -> None:
        """Find a heartbeat or a proof that is overdue."""
        if node.nmt != SILENT and now_s - node.heard_s > SILENT_AFTER_S:
            node.nmt, node.refusal = SILENT, ""
            if node.trusted:
                self._lose(node, f"silent: no heartbeat for {SILENT_AFTER_S:g} s", now_s)
        if node.trusted and now_s - node.trusted_s > STABLE_S:
            node.tries = 0
        if node.trusted and now_s - node.proven_s > limit_s:
            self._lose(node, f"not proven for {now_s - node.proven_s:.0f} s", now_s)

    def _bring_back(self, node: NodeRecord, now_s: float) -> None:
        """Begin to prove a node that is out; it is started when the proof is there."""
        # A stopped node answers no SDO (CiA 301, 7.3.2.2.4), and one without heartbeat may be stopped.
        if node.nmt == NmtState.STOPPED or (node.nmt == SILENT and node.tries):
            self._command(NmtCommand.ENTER_PRE_OPERATIONAL, node.contract.node_id)
        node.tries += 1
        self._begin(node, now_s)

    def _prove_in_turn(self, now_s: float) -> None:
        """Prove the node whose proof is oldest, as often as the bus's part for proofs allows."""
        if now_s < self._slot_s:
            return
        share_s = self._round_s / len(self._nodes)
        self._slot_s = max(self._slot_s, now_s - share_s) + share_s
        waiting = [node for node in self._nodes.values() if node.trusted and node.dialogue is None]
        oldest = min(waiting, key=lambda node: node.began_s, default=None)
        if oldest is None:
            return
        is_busy = now_s - oldest.foreign_sdo_s < SDO_QUIET_S
        if is_busy and now_s - oldest.began_s < self._round_s * oldest.cost:
            return
        self._slot_s += (oldest.cost - 1) * share_s
        self._begin(oldest, now_s)

    def _begin(self, node: NodeRecord, now_s: float) -> None:
        def doubt() -> None:
            if node.trusted:
                self._lose(node, "doubted: its configuration is not that of the layout", now_s)

        node.began_s = now_s
        steps = prove(node.settings, write=self._write, doubt=doubt)
        # A node that was never heard is not waited for: it says so when it comes.
        attempts = 1 if node.nmt == SILENT else ATTEMPTS
        node.dialogue = SdoDialogue(node.contract.node_id, steps, self._send, now_s, attempts=attempts)

    def _finish(self, node: NodeRecord, now_s: float) -> None:
        """Draw the conclusion of a dialogue that has ended."""
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
        # The last transfer has read the signature; without signature the first object was read first.
        node.refusal, node.proven_s = "", dialogue.asked_s if proof.has_signature else node.began_s
        if not node.trusted:
            self._let_in(node, now_s)

    def _let_in(self, node: NodeRecord, now_s: float) -> None:
        """Use the sums of a node that is proven, and start it; tries that were made before it was ever in count not."""
        node.trusted, node.trusted_s, node.hint = True, now_s, ""
        self._trust(node.contract, True)
        if node.nmt != NmtState.OPERATIONAL:
            self._command(NmtCommand.START, node.contract.node_id)
            node.nmt, node.heard_s = NmtState.OPERATIONAL, now_s
        if node.lost_s is not None:
            self._lines.add(node.contract.node_id, f"back after {now_s - node.lost_s:.1f} s", now_s)
            node.lost_s = None
        else:
            node.tries = 0  # it was not out: it had not been in yet

    def _lose(self, node: NodeRecord, why: str, now_s: float) -> None:
        """Use the sums of a node no longer, and bring it back after a pause."""
        node.trusted = False
        self._trust(node.contract, False)
        if node.lost_s is None:
            node.lost_s = now_s
        self._lines.add(node.contract.node_id, why, now_s)
        self._pause(node, now_s)

    def _pause(self, node: NodeRecord, now_s: float) -> None:
        """Set when a node that is out is asked next."""
        is_over = node.tries >= len(PAUSES_S)
        node.prove_at_s = now_s + (LATER_S if is_over else PAUSES_S[node.tries])
        if node.tries == len(PAUSES_S) and node.nmt != SILENT:
            self._lines.add(
                node.contract.node_id, f"given up after {len(PAUSES_S)} tries: tried again every {LATER_S:g} s", now_s
            )

    def _command(self, command: NmtCommand, node_id: int) -> None:
        self._send(NMT_COB_ID, bytes((command, node_id)))

    @staticmethod
    def _explanation(node: NodeRecord, now_s: float) -> str:
        return f" after EMCY {node.emcy:04X}h" if now_s - node.emcy_s < EXPLAINS_S else ""


def _state_text(state: int) -> str:
    try:
        return NmtState(state).name.lower().replace("_", "-")
    except ValueError:
        return f"state {state}"
