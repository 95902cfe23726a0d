"""The object dictionary of a running node: computed values, writes, signatures, stored parameters."""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import canopen

from dbc import indices as od
from dbc.canopen import Abort
from dbc.configuration import Setting, calibration, configuration, signature, with_calibration
from dbc.contract import Contract, NodeContract
from dbc.dictionary import ON_COMMAND, dictionary
from nodes.access import check_write, is_storable, number
from nodes.hardware import Hardware
from nodes.objects import LocalNode, object_dictionary
from nodes.storage import Parameters, Storage

#: Objects whose write is a command; a read tells that the node offers the command.
_COMMANDS: Final = (od.STORE, od.RESTORE)


class NodeObjects:
    """The objects of a node, and what a write does to its electronics and its memory.

    Parameters
    ----------
    storage : Storage
        Parameters that 1010h stored.
    serial_number : int
        1018h:4, that of the board.

    Attributes
    ----------
    local : LocalNode
        The SDO server with its values.
    readers : dict of int to callable
        Computed objects: returns the value of a sub-index, None for what is stored.
    writers : dict of int to callable
        Objects whose write is an order to the node.
    """

    def __init__(
        self,
        skin: Contract,
        contract: NodeContract,
        *,
        hardware: Hardware,
        storage: Storage,
        serial_number: int,
    ) -> None:
        self._contract, self._hardware, self._storage = contract, hardware, storage
        settings = configuration(skin, contract)
        self._signed = {
            od.SIGNATURE: settings,
            od.CALIBRATION_SIGNATURE: with_calibration(settings, calibration(skin, contract)),
        }
        self._signatures: dict[int, int] = {}
        self._changed = True
        first = contract.block
        self.readers: dict[int, Callable[[int], float | None]] = {
            od.IDENTITY: lambda subindex: serial_number if subindex == 4 else None,
            **{index: partial(self._read_signature, index) for index in self._signed},
            od.TEMPERATURE: lambda _: round(10 * hardware.temperature_k(range(first, first + contract.blocks))),
            **{
                od.of_block(index, place): partial(read, contract.block + place)
                for index, read in ((od.SUMS, self._read_sum), (od.COUNTS, self._read_count))
                for place in range(contract.blocks)
            },
            **{index: lambda subindex: ON_COMMAND if subindex else None for index in _COMMANDS},
        }
        self.writers: dict[int, Callable[[], None]] = {}
        # Nodes in Python have no program that could be exchanged.
        objects = [each for each in dictionary(skin, contract) if not od.is_program_download(each.index)]
        self.local = LocalNode(contract.node_id, object_dictionary(objects), contract.packing.bits, contract.pdo_bytes)
        self.local.add_write_callback(self._written)  # type: ignore[no-untyped-call]
        self.local.add_read_callback(self._read)  # type: ignore[no-untyped-call]

    def load(self, *, communication_only: bool = False) -> None:
        """Begin with the defaults and what 1010h has stored, or with those of the communication alone."""
        self.local.sdo.reset()
        store = self.local.data_store
        for index in [index for index in store if index < od.MANUFACTURER or not communication_only]:
            del store[index]
        stored = self._storage.parameters if self._storage.owner == self._contract.node_id else {}
        for index, entries in stored.items():
            for subindex, data in entries.items():
                if (index < od.MANUFACTURER or not communication_only) and self._is_stored(index, subindex, data):
                    store.setdefault(index, {})[subindex] = data
        if not communication_only:
            self._reset_electronics()
        self._signatures.clear()
        self._changed = True

    def take_changed(self) -> bool:
        """Tell whether an object of the communication may have changed since the last call."""
        changed, self._changed = self._changed, False
        return changed

    def _is_stored(self, index: int, subindex: int, data: bytes) -> bool:
        found = self.local.variable(index, subindex)
        return found is not None and found.writable and is_storable(index, found.data_type, data)

    def _reset_electronics(self) -> None:
        """Set the electronics to the dictionary's calibration and to no test pattern."""
        for place in range(self._contract.blocks):
            self._hardware.reset(self._contract.block + place)
        for index, entries in self.local.data_store.items():
            if index >= od.MANUFACTURER:
                for subindex, data in entries.items():
                    self._adjust(index, subindex, data)

    def _adjust(self, index: int, subindex: int, data: bytes) -> None:
        """Pass a value of the manufacturer's area to the electronics."""
        place, first = od.split_block(index)
        if first == od.OFFSET:
            value: float = int.from_bytes(data, "little", signed=True)
        else:
            found = self.local.variable(index, subindex)
            value = number(found.data_type if found else None, data)
        self._hardware.adjust(self._contract.block + place, first, subindex, value)

    def _read(self, *, index: int, subindex: int, **_: object) -> Any:
        """Return the present value of a computed object; None for stored objects."""
        reader = self.readers.get(index)
        return reader(subindex) if reader else None

    def _read_signature(self, index: int, _subindex: int) -> int:
        """Return the signature of the present values; test patterns are read from the electronics."""
        if index not in self._signatures:
            covered = self._signed[index]
            self._signatures[index] = signature((each.index, each.subindex, self._value(each)) for each in covered)
        return self._signatures[index]

    def _value(self, setting: Setting) -> bytes:
        place, first = od.split_block(setting.index)
        if first == od.TEST_PATTERN:
            return bytes((self._hardware.pattern(self._contract.block + place),))
        return self.local.get_data(setting.index, setting.subindex)

    def _read_sum(self, block: int, subindex: int) -> int | None:
        first = self._hardware.first_sum(block) + subindex - 1
        return int(self._contract.packing.raw(self._hardware.sums[first : first + 1])[0]) if subindex else None

    def _read_count(self, block: int, subindex: int) -> int | None:
        return int(self._hardware.counts(block)[subindex - 1]) if subindex else None

    def _written(self, *, index: int, subindex: int, data: bytes, **entry: Any) -> None:
        check_write(self.local, index, subindex, number(entry["od"].data_type, data))
        if index in self.writers:
            self.writers[index]()
        elif index == od.STORE:
            self._store({at: dict(entries) for at, entries in self.local.data_store.items() if at not in _COMMANDS})
        elif index == od.RESTORE:
            self._store({})
        self._signatures.clear()
        if index >= od.MANUFACTURER:
            self._adjust(index, subindex, data)
        else:
            self._changed = True

    def _store(self, parameters: Parameters) -> None:
        try:
            if parameters:
                self._storage.save(parameters)
            else:
                self._storage.clear()
        except OSError as error:
            raise canopen.SdoAbortedError(Abort.HARDWARE) from error
