"""From the dictionary as data to the ``canopen`` library's object dictionary and local node."""

import logging
from collections.abc import Callable
from typing import Any, Final, cast

import canopen
from canopen.objectdictionary import ODRecord, ODVariable
from canopen.sdo.server import SdoServer

from dbc.contract import LONGEST_VALUE
from dbc.dictionary import Object
from dbc.indices import BITS, OD_SUMS, split_block

#: Abort codes (CiA 301, table 22): command specifier not valid; value too long.
ABORT_COMMAND: Final = 0x0504_0001
ABORT_TOO_LONG: Final = 0x0607_0012

# The library logs every request it refuses; the abort on the bus says it already.
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
            # Arrays, too: the library's own array has every sub-index that is asked for.
            dictionary.add_object(ODRecord(each.group, each.index))
        group = dictionary[each.index]
        if isinstance(group, ODRecord):
            group.add_member(variable)
    return dictionary


class BoundedSdoServer(SdoServer):
    """The library's SDO server, which neither a download without end nor a segment out of turn can upset."""

    _buffer: bytearray | None

    def __init__(self, rx_cobid: int, tx_cobid: int, node: canopen.LocalNode) -> None:
        super().__init__(rx_cobid, tx_cobid, node)  # type: ignore[no-untyped-call]
        self._index = self._subindex = 0  # what an abort before the first transfer names

    def segmented_upload(self, command: int) -> None:
        """Send one segment (CiA 301, 7.2.4.3.6), or abort where no transfer was begun."""
        if self._buffer is None:
            raise canopen.SdoAbortedError(ABORT_COMMAND)
        super().segmented_upload(command)  # type: ignore[no-untyped-call]

    def segmented_download(self, command: int, request: bytes) -> None:
        """Take one segment (CiA 301, 7.2.4.3.4), or abort a value longer than any object."""
        if self._buffer is None:
            raise canopen.SdoAbortedError(ABORT_COMMAND)
        if len(self._buffer) > LONGEST_VALUE:
            self._buffer = None
            raise canopen.SdoAbortedError(ABORT_TOO_LONG)
        super().segmented_download(command, request)  # type: ignore[no-untyped-call]


class LocalNode(canopen.LocalNode):
    """The library's local node for its dictionary and SDO server only; NMT and heartbeat are `nodes.node`'s.

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
        self.sdo = BoundedSdoServer(self.sdo.rx_cobid, self.sdo.tx_cobid, self)
        # The library would start a thread per node for the heartbeat.
        self._write_callbacks.clear()

    def on_write(self, callback: Callable[..., None]) -> None:
        """Call ``callback(index=, subindex=, od=, data=)`` before a value is stored; it may raise an abort."""
        self._write_callbacks.append(callback)

    def on_read(self, callback: Callable[..., Any]) -> None:
        """Call ``callback(index=, subindex=, od=)`` for every read; None lets the stored value be read."""
        self._read_callbacks.append(callback)

    def unsigned(self, index: int, subindex: int = 0) -> int:
        """Return the present value of an unsigned object."""
        return int.from_bytes(self.get_data(index, subindex), "little")

    def mappable_bits(self, index: int, subindex: int) -> int | None:
        """Return the width of an object in a PDO, None when PDOs may not carry it."""
        found = self.variable(index, subindex)
        if found is None or not found.pdo_mappable:
            return None
        return self.sum_bits if split_block(index)[1] == OD_SUMS else BITS.get(found.data_type or 0)

    def variable(self, index: int, subindex: int) -> ODVariable | None:
        """Return the description of an object, None when it does not exist."""
        found = self.object_dictionary.get(index)
        if isinstance(found, ODVariable):
            return found if subindex == 0 else None
        if found is None or subindex not in found.subindices:
            return None
        return cast("ODVariable", found.subindices[subindex])
