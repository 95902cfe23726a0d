"""Boot of the nodes of one bus: check what each one measures, then start it (after CiA 302-2's boot NMT slave).

Runs beside the receive loop, because an SDO transfer waits for answers. A node that does not answer is asked again
when it shows itself by a boot-up message or a heartbeat.
"""

import logging
import queue
import threading
from collections.abc import Callable, Iterable
from typing import Final

import canopen

from dbc.contract import LONGEST_VALUE, NMT_COB_ID, NodeContract, encoding_text
from dbc.indices import OD_BLOCK, OD_ENCODING, OD_PHI_FINGERPRINT
from gateway.network import MasterNetwork
from skin.service import say

NMT_START: Final = 1
#: An SDO answer waits behind a whole burst of sums; five SYNC periods are ample.
SDO_TIMEOUT_S: Final = 0.3
#: Below are the aborts of a transfer (CiA 301, table 22: toggle bit, time-out, command), which say nothing of the node.
FIRST_ABORT_OF_THE_OBJECT: Final = 0x0600_0000
#: What a segment of an SDO transfer carries (CiA 301, 7.2.4.3.6).
SEGMENT_BYTES: Final = 7
#: Stands in the queue behind the nodes of the first pass; no node has this ID.
_FIRST_PASS_ENDS: Final = 0

# The library logs each transfer without answer; a node that is not there is no news.
logging.getLogger("canopen.sdo.client").setLevel(logging.CRITICAL)


class Boot:
    """Checks and starts nodes, one after another, in a thread of its own.

    Parameters
    ----------
    name : str
        The bus, for messages.
    nodes : iterable of NodeContract
        All nodes of the bus.
    fingerprint : str
        The Φ every node must have.
    network : MasterNetwork
    trust : callable
        Called with a node and whether its sums may be used.
    """

    def __init__(
        self,
        name: str,
        nodes: Iterable[NodeContract],
        fingerprint: str,
        network: MasterNetwork,
        trust: Callable[[NodeContract, bool], None],
    ) -> None:
        self._name = name
        self._nodes = {node.node_id: node for node in nodes}
        self._fingerprint = fingerprint
        self._network = network
        self._trust = trust
        self._wanted: queue.SimpleQueue[int | None] = queue.SimpleQueue()
        self._queued: set[int] = set()
        #: Nodes that answered with another Φ, until they boot again.
        self.refused: set[int] = set()
        self._first_pass = threading.Event()
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"boot {name}", daemon=True)

    def start(self) -> None:
        """Begin with a pass over all nodes."""
        self.ask(self._nodes)
        self._wanted.put(_FIRST_PASS_ENDS)
        self._thread.start()

    def ask(self, node_ids: Iterable[int]) -> None:
        """Check these nodes as soon as possible; a node already waiting is not queued twice."""
        for node_id in node_ids:
            self.refused.discard(node_id)
            if node_id not in self._queued:
                self._queued.add(node_id)
                self._wanted.put(node_id)

    @property
    def passed(self) -> bool:
        """Whether every node has been asked once."""
        return self._first_pass.is_set()

    def stop(self) -> None:
        """End the thread after the node it is at."""
        self._stopping.set()
        self._wanted.put(None)

    def _run(self) -> None:
        while (node_id := self._wanted.get()) is not None and not self._stopping.is_set():
            if node_id == _FIRST_PASS_ENDS:
                self._first_pass.set()
                continue
            self._queued.discard(node_id)
            self._check(self._nodes[node_id])

    def _check(self, node: NodeContract) -> None:
        remote = canopen.RemoteNode(node.node_id, canopen.ObjectDictionary())
        remote.sdo.RESPONSE_TIMEOUT = SDO_TIMEOUT_S
        self._network[node.node_id] = remote
        try:
            block = int.from_bytes(_read(remote, OD_BLOCK), "little")
            encoding = int.from_bytes(_read(remote, OD_ENCODING), "little")
            phi = _read(remote, OD_PHI_FINGERPRINT).decode("ascii", "replace")
        except canopen.SdoCommunicationError:
            return
        except canopen.SdoAbortedError as error:
            if error.code < FIRST_ABORT_OF_THE_OBJECT:
                return  # the transfer was disturbed: the node is asked again
            self.refused.add(node.node_id)
            say("gateway", f"node {node.node_id} on {self._name} is no skin node: {error}")
            return
        except Exception as error:  # noqa: BLE001 - whatever answers on the wire, the next node is asked
            say("gateway", f"node {node.node_id} on {self._name} answers strangely: {error}")
            return
        finally:
            del self._network[node.node_id]  # answers that nobody asked for would pile up there
        if (block, phi, encoding) != (node.block, self._fingerprint, node.encoding):
            self.refused.add(node.node_id)
            say(
                "gateway",
                f"node {node.node_id} on {self._name} refused: expected block {node.block} of Φ {self._fingerprint}"
                f" in {encoding_text(node.encoding)}, got block {block} of Φ {phi} in {encoding_text(encoding)}",
            )
            return
        self._trust(node, True)
        self._network.send_message(NMT_COB_ID, bytes((NMT_START, node.node_id)))


def _read(remote: canopen.RemoteNode, index: int) -> bytes:
    """Return the value of an object; a transfer without end is left after `LONGEST_VALUE`."""
    with remote.sdo.open(index, 0, buffering=0) as transfer:
        value = b""
        while segment := transfer.read(SEGMENT_BYTES):
            value += segment
            if len(value) > LONGEST_VALUE:
                raise ValueError(f"object {index:04X}h is longer than {LONGEST_VALUE} bytes")
    return value
