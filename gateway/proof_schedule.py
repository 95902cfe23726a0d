"""When the nodes of one bus are proven: those that are due, and in turn those in use."""

from collections.abc import Sequence
from typing import Final

from dbc.configuration import DIALOGUES, PROOF_ROUNDS
from gateway.node_machine import NodeMachine
from gateway.sdo import ATTEMPTS, TIMEOUT_S

_NEVER_S: Final = float("-inf")


class ProofSchedule:
    """The order of the proofs.

    Parameters
    ----------
    nodes : sequence of NodeMachine
        Of one bus.
    round_s : float
        Time in which each node in use is proven once, if a proof is one transfer.
    """

    def __init__(self, nodes: Sequence[NodeMachine], round_s: float) -> None:
        self._nodes, self._round_s = nodes, round_s
        #: When the share of the bus for proofs allows the next.
        self._next_s = _NEVER_S

    @property
    def limit_s(self) -> float:
        """How long a block stays valid after the last proof of its node."""
        mean_cost = sum([node.cost for node in self._nodes]) / len(self._nodes)
        return PROOF_ROUNDS * self._round_s * mean_cost + ATTEMPTS * TIMEOUT_S

    def begin_due(self, now_s: float) -> None:
        """Begin the proofs that are due, as many as there may be; another master's download goes on undisturbed."""
        tried = [node for node in self._nodes if now_s >= max(node.prove_at_s, node.alone_s) and node.dialogue is None]
        due = [node for node in tried if now_s >= node.foreign.free_s]
        if not due:
            return
        free = DIALOGUES - sum(node.dialogue is not None for node in self._nodes)
        for node in sorted(due, key=lambda node: node.prove_at_s)[: max(0, free)]:
            node.begin_proof(now_s)

    def prove_in_turn(self, now_s: float) -> None:
        """Prove the node whose proof is oldest, as often as the share of the bus for proofs allows."""
        if now_s < self._next_s:
            return
        share_s = self._round_s / len(self._nodes)
        self._next_s = max(self._next_s, now_s - share_s) + share_s
        waiting = [node for node in self._nodes if node.in_use and node.is_free]
        oldest = min(waiting, key=lambda node: node.began_s, default=None)
        if oldest is None:
            return
        if now_s < oldest.foreign.free_s and now_s - oldest.began_s < self._round_s * oldest.cost:
            return
        self._next_s += (oldest.cost - 1) * share_s
        oldest.begin_proof(now_s)
