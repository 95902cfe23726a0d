"""Objects of a CANopen device by name or number, from its EDS: found, read and written by SDO."""

import configparser
import difflib
import io
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import canopen
from canopen.objectdictionary import datatypes
from canopen.objectdictionary.eds import import_eds

from bus.link import Send
from canskin.errors import InputError, RunError
from dbc import indices as od
from dbc.canopen import SDO_RESPONSE_BASE
from dbc.contract import LONGEST_VALUE, Contract, NodeContract
from dbc.eds import eds, node_types
from dbc.frame import Frames, one_frame, received
from dbc.values import decode
from gateway.sdo import Download, Read, SdoDialogue, Transfer, Write, one
from skin.limits import TEXT_BYTES_MAX, read_text

#: Names of CANopen's data types (CiA 301, table 44).
_TYPES: Final = {value: name for name, value in vars(datatypes).items() if name.isupper() and isinstance(value, int)}
#: Units of objects of CiA 301, by index and sub-index; of TPDOs by the index of the first. No EDS has units.
_UNITS: Final = {
    (od.CYCLE_PERIOD_US, 0): "µs",
    (od.WINDOW_US, 0): "µs",
    (od.EMCY_INHIBIT_100US, 0): "x 100 µs",
    (od.HEARTBEAT_MS, 0): "ms",
    (od.TPDO_COMMUNICATION, 3): "x 100 µs",
    (od.TPDO_COMMUNICATION, 5): "ms",
}
#: Most bytes of an expedited download.
_EXPEDITED: Final = 4


@dataclass(frozen=True)
class Entry:
    """A variable, or an entry of a record or array; `name` has the name of the record before it."""

    index: int
    subindex: int
    name: str
    variable: Any = field(compare=False)

    @property
    def place(self) -> str:
        """Index and sub-index as text."""
        return f"{self.index:04X}h:{self.subindex}"

    @property
    def type_name(self) -> str:
        """Name of the data type, or its number."""
        number = self.variable.data_type
        return _TYPES.get(number, f"type {number:04X}h")

    @property
    def unit(self) -> str:
        """Unit of the value, empty if unknown."""
        is_tpdo = od.TPDO_COMMUNICATION <= self.index < od.TPDO_MAPPING
        index = od.TPDO_COMMUNICATION if is_tpdo else self.index
        return self.variable.unit or _UNITS.get((index, self.subindex), "")

    def decode(self, data: bytes) -> int | float | str | bool:
        """Return a value, of a type that is not known its bytes in hexadecimal."""
        return decode(self.variable.data_type, data)

    def encode(self, text: str) -> bytes:
        """Return the bytes of a value; InputError if the text is no value of the type."""
        kind, variable, place = self.variable.data_type, self.variable, f"{self.name} ({self.place})"
        is_whole = kind in datatypes.INTEGER_TYPES or kind == datatypes.BOOLEAN
        try:
            value = _whole(text) if is_whole else float(text) if kind in datatypes.FLOAT_TYPES else text
            data = bytes(variable.encode_raw(value))
        except (ValueError, struct.error, OverflowError, TypeError, canopen.ObjectDictionaryError) as error:
            raise InputError(f"{place}: expected a value of {self.type_name}, got '{text}'") from error
        least, most = variable.min, variable.max
        is_low = not isinstance(value, str) and least is not None and value < least
        if is_low or (not isinstance(value, str) and most is not None and value > most):
            raise InputError(f"{place}: expected {least} to {most}, got {text}")
        if not 1 <= len(data) <= LONGEST_VALUE:
            raise InputError(f"{place}: expected a value of 1 to {LONGEST_VALUE} bytes, got {len(data)}")
        return data


def _whole(text: str) -> int:
    """Return the number of ``1635``, ``0x663`` or, as CiA 301 writes it, ``663h``."""
    return int(text[:-1], 16) if text.lower().endswith("h") else int(text, 0)


def entries_of_node(contract: Contract, node: NodeContract) -> list[Entry]:
    """Return the objects of a board of the skin."""
    kind = next(each for each in node_types(contract) if node in each.nodes)
    return _entries(eds(contract, kind), node.node_id, kind.file)


def entries_of_file(path: Path, node_id: int) -> list[Entry]:
    """Return the objects of an EDS or DCF file."""
    text = read_text(path, InputError, "the objects", TEXT_BYTES_MAX)
    return _entries(text, node_id, str(path))


def _entries(text: str, node_id: int, origin: str) -> list[Entry]:
    try:
        dictionary = import_eds(io.StringIO(text), node_id)
    except configparser.Error as error:  # its text quotes the file
        raise InputError(f"{origin}: expected an EDS or DCF (CiA 306), got a file without its sections") from error
    except Exception as error:  # of int and canopen: any of their errors
        raise InputError(f"{origin}: expected an EDS (CiA 306): {' '.join(str(error).split())}") from error
    if not dictionary:
        raise InputError(f"{origin}: expected an EDS or DCF (CiA 306), got a file without objects")
    found = []
    for index, each in sorted(dictionary.items()):
        if isinstance(each, canopen.objectdictionary.ODVariable):
            found.append(Entry(index, 0, each.name, each))
        else:
            found += [Entry(index, sub, f"{each.name}.{each[sub].name}", each[sub]) for sub in sorted(each)]
    return found


def find(entries: Sequence[Entry], wanted: str) -> list[Entry]:
    """Return the entries that a text names.

    Parameters
    ----------
    wanted : str
        ``1017``, ``1018h:1``, ``0x1018:1``; the name of an object (all its entries), of ``RECORD.ENTRY`` or of an entry
        that no other has. Lower and upper case are equal.
    """
    number = re.fullmatch(r"(?:0x)?([0-9a-f]{4})h?(?::(\d+|0x[0-9a-f]+))?", wanted.strip(), re.IGNORECASE)
    if number:
        index, sub = int(number[1], 16), None if number[2] is None else int(number[2], 0)
        found = [each for each in entries if each.index == index and sub in (None, each.subindex)]
    else:
        name = wanted.strip().lower()
        whole = [each for each in entries if each.name.lower() == name or each.name.lower().startswith(f"{name}.")]
        found = whole or [each for each in entries if each.variable.name.lower() == name]
        if not whole and len({each.index for each in found}) > 1:
            raise InputError(f"'{wanted}' names {', '.join(each.name for each in found)}: expected one of them")
    if not found:
        names = {each.name.lower(): each.name for each in entries}
        near = difflib.get_close_matches(wanted.lower(), names, 3, 0.5)
        hint = f"; near are {', '.join(names[each] for each in near)}" if near else ""
        raise InputError(f"expected an object of the device, by name or index:sub, got '{wanted}'{hint}")
    return found


def parse_writes(entries: Sequence[Entry], texts: Sequence[str]) -> list[tuple[Entry, bytes]]:
    """Return what to write, of texts such as ``Producer heartbeat time=500``."""
    writes = []
    for text in texts:
        name, sign, value = text.partition("=")
        found = find(entries, name) if sign else []
        if len(found) != 1:
            raise InputError(f"expected OBJECT=VALUE with one object, got '{text}'")
        if not found[0].variable.writable:
            access = found[0].variable.access_type
            raise InputError(f"{found[0].name} ({found[0].place}) cannot be written, its access is {access}: {text}")
        writes.append((found[0], found[0].encode(value.strip())))
    return writes


class NodeTransfers:
    """Transfers with one node, one after another: frames and times in, requests out.

    Parameters
    ----------
    entries : list of Entry
        What is read; before, `writes` are written.

    Attributes
    ----------
    done : bool
    values : dict of Entry to bytes or str
        What was read, or why it could not be read.

    Raises
    ------
    RunError
        By `take` and `tick`: a write has failed. Nothing is read or written after that.
    """

    def __init__(
        self,
        node_id: int,
        entries: Sequence[Entry],
        send: Send,
        now_s: float,
        writes: Sequence[tuple[Entry, bytes]] = (),
    ) -> None:
        self._node_id, self._send = node_id, send
        self._left = [*writes, *((each, b"") for each in entries)]
        self._written: list[str] = []
        self.values: dict[Entry, bytes | str] = {}
        self.done = False
        #: A transfer is looked at in every turn.
        self.due_s = float("inf")
        self._begin(now_s)

    def _begin(self, now_s: float) -> None:
        entry, data = self._left[0]
        if not data:
            transfer: Transfer = Read(entry.index, entry.subindex, entry.variable.data_type)
        elif len(data) <= _EXPEDITED:
            transfer = Write(entry.index, entry.subindex, data)
        else:
            transfer = Download(entry.index, entry.subindex, data, in_blocks=False)
        self._dialogue = SdoDialogue(self._node_id, one(transfer), self._send_one, now_s)

    def _send_one(self, can_id: int, data: bytes) -> None:
        self._send(one_frame(can_id, data))

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use received frames."""
        plain = received(arrived)
        for each in plain[plain["can_id"] == SDO_RESPONSE_BASE + self._node_id]:
            self._dialogue.take(each["data"][: each["length"]].tobytes(), now_s)
            self._look(now_s)

    def tick(self, now_s: float) -> None:
        """Repeat what was not answered."""
        self._dialogue.tick(now_s)
        self._look(now_s)

    def give_up(self, now_s: float) -> None:  # noqa: ARG002  nothing has to be undone
        """End."""
        self.done = True

    def _look(self, now_s: float) -> None:
        if self.done or not self._dialogue.done:
            return
        (entry, data), *self._left = self._left
        error = self._dialogue.error
        if error is not None and data:
            before = f"; written before: {', '.join(self._written)}" if self._written else ""
            raise RunError(f"node {self._node_id}: {entry.name} is not written: {error}{before}")
        if data:
            self._written.append(entry.name)
        else:
            result = self._dialogue.result
            self.values[entry] = (
                str(error) if error is not None else bytes(result) if isinstance(result, bytes) else b""
            )
        self.done = not self._left
        if not self.done:
            self._begin(now_s)
