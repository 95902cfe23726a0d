"""A skin on its hub, heard for a while: for commands that say how it is, and end."""

import threading
import time
from collections import defaultdict
from typing import Final

import msgspec

from canskin.fabric import Fabric
from canskin.messages import GatewayStatus
from canskin.peers import Peer
from health.snapshot import Snapshot
from health.state import TOPICS, ViewState
from skin.layout import Layout

#: What notices call the program that looks: "this command".
_NAME: Final = "command"


class HubLook:
    """Hears what a skin sends, from now on.

    Attributes
    ----------
    loads : dict of str to list of float
        The loads of each bus that the gateway has told.

    Raises
    ------
    DeniedError
        If the keys may not hear all that says how the skin is.
    """

    def __init__(self, layout: Layout, fabric: Fabric) -> None:
        self.loads: defaultdict[str, list[float]] = defaultdict(list)
        self._fabric, self._lock = fabric, threading.Lock()
        self._begun_time_s = time.time()
        self._state = ViewState(layout, time.time() - time.monotonic(), _NAME)
        for topic in TOPICS:
            fabric.subscribe(topic, self._take)
        fabric.watch_peers(self._note)

    def snapshot(self) -> Snapshot:
        """Return the skin as it is now, with the times since when that are before the look."""
        with self._lock:
            snapshot, _ = self._state.snapshot(time.monotonic(), self._fabric.malformed)
        notices = []
        for each in snapshot.notices:
            is_old = each.since_time_s is not None and each.since_time_s < self._begun_time_s
            notices.append(each if is_old else msgspec.structs.replace(each, since_time_s=None))
        return msgspec.structs.replace(snapshot, notices=notices)

    def _take(self, message: msgspec.Struct) -> None:
        with self._lock:
            if self._state.take(message, time.monotonic()) and isinstance(message, GatewayStatus):
                for bus in message.buses:
                    self.loads[bus.name].append(bus.load_ratio)

    def _note(self, peer: Peer, alive: bool) -> None:
        with self._lock:
            self._state.take_peer(peer, alive, time.monotonic())
