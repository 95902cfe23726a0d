"""An NMT command to one node or all nodes of a bus, and the state that each tells afterwards (CiA 301, 7.2.8.3)."""

from collections.abc import Collection
from typing import Final

from bus.link import Send
from dbc.canopen import (
    COMMANDED,
    HEARTBEAT_BASE,
    HEARTBEAT_BYTES,
    NMT_COB_ID,
    NmtCommand,
    NmtState,
    is_of_node,
)
from dbc.frame import Frames, one_frame, received

#: Three heartbeats of a skin's nodes.
WAIT_S: Final = 3.0


class NodeOrder:
    """One NMT command: frames and times in, the command out.

    Parameters
    ----------
    node_id : int
        Whom the command is for; 0 for all nodes of the bus.
    awaited : collection of int
        Node-IDs that have to tell the state that the command leads to: by a heartbeat, after a reset by the boot-up.

    Attributes
    ----------
    done : bool
        All have told the state, or `WAIT_S` are over.
    states : dict of int to int or None
        By node-ID the newest state that was told since the command.
    missing : list of int
        Node-IDs that have not told the awaited state.
    """

    def __init__(self, command: NmtCommand, node_id: int, awaited: Collection[int], send: Send, now_s: float) -> None:
        self.states: dict[int, int | None] = dict.fromkeys(sorted(awaited))
        self.missing = list(self.states)
        self.due_s = now_s + WAIT_S
        self.done = False
        self._state = COMMANDED.get(command, NmtState.INITIALISING)
        send(one_frame(NMT_COB_ID, bytes((command, node_id))))

    def take(self, arrived: Frames, now_s: float) -> None:  # noqa: ARG002  a talk's frames come with the time
        """Use received frames."""
        plain = received(arrived)
        told = is_of_node(plain["can_id"], HEARTBEAT_BASE) & (plain["length"] == HEARTBEAT_BYTES)
        for each in plain[told]:
            node_id, state = int(each["can_id"]) - HEARTBEAT_BASE, int(each["data"][0]) & 0x7F
            if node_id in self.missing:
                self.states[node_id] = state
                if state == self._state:
                    self.missing.remove(node_id)
        self.done = self.done or not self.missing

    def tick(self, now_s: float) -> None:
        """End the wait when it is over."""
        self.done = self.done or now_s >= self.due_s

    def give_up(self, now_s: float) -> None:  # noqa: ARG002  nothing has to be undone
        """End."""
        self.done = True
