"""Object dictionary, local node and network of the ``canopen`` library, made from `dbc.dictionary`."""

import logging
from typing import Final, cast

import canopen
import numpy as np
from canopen.objectdictionary import ODRecord, ODVariable
from canopen.objectdictionary.datatypes import NUMBER_TYPES
from canopen.sdo.constants import EXPEDITED, NO_MORE_DATA, SIZE_SPECIFIED
from canopen.sdo.server import SdoServer

from dbc import indices as od
from dbc.canopen import HIGHEST_NODE_ID, Abort
from dbc.contract import LONGEST_VALUE
from dbc.frame import Frames, frames, one_frame
from dbc.objects import Object

#: Bits of a command that tell how many of the four bytes of an expedited transfer are not used.
UNUSED_BYTES: Final = 0x0C

# The library logs every request that it refuses; the abort on the bus is enough.
logging.getLogger("canopen.sdo.server").setLevel(logging.CRITICAL)


def object_dictionary(objects: list[Object]) -> canopen.ObjectDictionary:
    """Build the library's object dictionary."""
    dictionary = canopen.ObjectDictionary()
    for each in objects:
        variable = ODVariable(each.name, each.index, each.subindex or 0)
        variable.data_type = each.data_type
        variable.access_type = each.access
        # The library's annotation knows integers only; strings and floats work.
        variable.default = cast("int", each.value)
        variable.pdo_mappable = each.pdo
        if each.subindex is None:
            dictionary.add_object(variable)
            continue
        if each.index not in dictionary:
            # A record for arrays, too: the library's array answers every sub-index.
            dictionary.add_object(ODRecord(each.group, each.index))
        group = dictionary[each.index]
        if isinstance(group, ODRecord):
            group.add_member(variable)
    return dictionary


class StrictSdoServer(SdoServer):
    """The library's SDO server, made as strict as CiA 301, 7.2.4.

    A segment must belong to an open transfer of the same direction. A download has a largest length. An expedited
    download without a size takes the size of the object. Block transfer is refused.
    """

    _buffer: bytearray | None

    def __init__(self, rx_cobid: int, tx_cobid: int, node: "LocalNode") -> None:
        super().__init__(rx_cobid, tx_cobid, node)  # type: ignore[no-untyped-call]
        self._local = node
        self._is_upload = False
        self.reset()

    def reset(self) -> None:
        """End an open transfer without an answer: the node is initialised (CiA 301, 7.3.2.2)."""
        self._buffer = None
        self._index = self._subindex = 0  # what an abort before the first transfer names

    def init_upload(self, request: bytes) -> None:
        """Begin an upload (7.2.4.3.5); a value of more than four bytes follows in segments."""
        self._buffer, self._is_upload = None, True
        super().init_upload(request)  # type: ignore[no-untyped-call]

    def segmented_upload(self, command: int) -> None:
        """Send one segment (7.2.4.3.6)."""
        if self._buffer is None or not self._is_upload:
            raise canopen.SdoAbortedError(Abort.COMMAND)
        super().segmented_upload(command)  # type: ignore[no-untyped-call]
        if not self._buffer:
            self._buffer = None

    def init_download(self, request: bytes) -> None:
        """Begin a download (7.2.4.3.3)."""
        self._buffer, self._is_upload = None, False
        command = request[0]
        if command & EXPEDITED and not command & SIZE_SPECIFIED:
            described = self._local.variable(int.from_bytes(request[1:3], "little"), request[3])
            if described is not None and described.data_type in NUMBER_TYPES:
                unused = 4 - min(4, len(described) // 8)
                # The bits of the number of unused bytes have no meaning without a size.
                request = bytes((command & ~UNUSED_BYTES | SIZE_SPECIFIED | unused << 2, *request[1:]))
        super().init_download(request)  # type: ignore[no-untyped-call]

    def segmented_download(self, command: int, request: bytes) -> None:
        """Take one segment (7.2.4.3.4)."""
        if self._buffer is None or self._is_upload:
            raise canopen.SdoAbortedError(Abort.COMMAND)
        if len(self._buffer) > LONGEST_VALUE:
            raise canopen.SdoAbortedError(Abort.TOO_LONG)
        super().segmented_download(command, request)  # type: ignore[no-untyped-call]
        if command & NO_MORE_DATA:
            self._buffer = None

    def block_upload(self, data: bytes) -> None:
        """Switch to an upload in segments if the client allows the switch for this size (7.2.4.3.12)."""
        index, subindex, switch_below = int.from_bytes(data[1:3], "little"), data[3], data[5]
        self._index, self._subindex = index, subindex
        if data[0] & 0x03 or len(self._local.get_data(index, subindex)) > switch_below:
            raise canopen.SdoAbortedError(Abort.COMMAND)
        self.init_upload(data)

    def request_aborted(self, data: bytes) -> None:
        """End the transfer."""
        self._buffer = None
        super().request_aborted(data)  # type: ignore[no-untyped-call]

    def abort(self, abort_code: int = 0x0800_0000) -> None:
        """End the transfer with an abort code."""
        self._buffer = None
        super().abort(abort_code)  # type: ignore[no-untyped-call]


class LocalNode(canopen.LocalNode):
    """The library's local node, used for dictionary and SDO server only; `nodes.node` does NMT and heartbeat.

    Attributes
    ----------
    sum_bits : int
        Width of a sum in a PDO.
    pdo_bytes : int
        Longest payload of a PDO.
    """

    def __init__(self, node_id: int, dictionary: canopen.ObjectDictionary, sum_bits: int, pdo_bytes: int) -> None:
        super().__init__(node_id, dictionary)
        self.sum_bits = sum_bits
        self.pdo_bytes = pdo_bytes
        self.sdo: StrictSdoServer = StrictSdoServer(self.sdo.rx_cobid, self.sdo.tx_cobid, self)
        # The library would start a thread per node for the heartbeat.
        self._write_callbacks.clear()

    def _find_object(self, index: int, subindex: int) -> ODVariable:
        """Return the description of an object; the library would accept any sub-index of a variable."""
        found = self.variable(index, subindex)
        if found is None:
            raise canopen.SdoAbortedError(Abort.NO_SUBINDEX if index in self.object_dictionary else Abort.NO_OBJECT)
        return found

    def unsigned(self, index: int, subindex: int = 0) -> int:
        """Return a stored unsigned value; faster than the library, which matters for 32 TPDOs of every node."""
        data = self.data_store.get(index, {}).get(subindex)
        if data is None:
            return int(self._find_object(index, subindex).default or 0)
        return int.from_bytes(data, "little")

    def mappable_bits(self, index: int, subindex: int) -> int | None:
        """Return the width of an object in a PDO, None when PDOs may not carry it."""
        found = self.variable(index, subindex)
        if found is None or not found.pdo_mappable:
            return None
        return self.sum_bits if od.split_block(index)[1] == od.SUMS else od.BITS.get(found.data_type or 0)

    def variable(self, index: int, subindex: int) -> ODVariable | None:
        """Return the description of an object, None when it does not exist."""
        found = self.object_dictionary.get(index)
        if isinstance(found, ODVariable):
            return found if subindex == 0 else None
        if found is None or subindex not in found.subindices:
            return None
        return cast("ODVariable", found.subindices[subindex])


class Outbox(canopen.Network):
    """The ``canopen`` library's network without a bus: keeps what nodes send until somebody takes it."""

    def __init__(self) -> None:
        super().__init__()
        self._waiting: list[Frames] = []

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: ARG002
        """Send one classic frame."""
        frame = one_frame(can_id, data)
        frame["port"] = can_id & HIGHEST_NODE_ID
        self.post(frame)

    def post(self, burst: Frames) -> None:
        """Send frames."""
        self._waiting.append(burst)

    def take(self) -> Frames:
        """Return what was sent since the last call."""
        waiting, self._waiting = self._waiting, []
        return waiting[0] if len(waiting) == 1 else np.concatenate([frames(0), *waiting])
