"""LSS slave of one virtual node (CiA 305): the node gets its node-ID over the bus."""

from collections.abc import Callable, Collection
from typing import Final

from dbc.canopen import FASTSCAN_ALL, LSS_BIT_RATES_HZ, LSS_BYTES, NO_NODE_ID, Lss, LssError

_ADDRESS: Final = range(Lss.SWITCH_SELECTIVE, Lss.SWITCH_SELECTIVE + 4)
_RANGES: Final = range(Lss.IDENTIFY, Lss.IDENTIFY + 6)
_INQUIRIES: Final = range(Lss.INQUIRE_ADDRESS, Lss.INQUIRE_ADDRESS + 4)


class LssSlave:
    """Takes requests of the LSS master and returns responses.

    Parameters
    ----------
    address : tuple of int, shape (4,)
        Vendor-ID, product code, revision and serial number.
    known : collection of int
        The node-IDs that the board takes: its image has constants for them.
    bit_rate_hz : int
        The only bit rate that the node takes: that of its bus.
    store : callable
        Stores the node-ID, `NO_NODE_ID` for none; OSError if that fails.
    stored : int
        The node-ID that is stored already, or set by switches; `NO_NODE_ID` for none.

    Attributes
    ----------
    node_id : int
        The node-ID in use, `NO_NODE_ID` before the first.
    wanted : int
        The node-ID from the next initialisation on.
    is_configured : bool
        The node is in the state LSS configuration; the LED of a board flickers then (CiA 303-3).
    """

    def __init__(
        self,
        address: tuple[int, ...],
        known: Collection[int],
        bit_rate_hz: int,
        store: Callable[[int], None],
        *,
        stored: int,
    ) -> None:
        self._address, self._known, self._bit_rate_hz, self._store = address, known, bit_rate_hz, store
        self.node_id = NO_NODE_ID
        self._stored = stored
        self.reset()

    def reset(self) -> None:
        """Power up: the stored node-ID counts."""
        self.wanted = self._stored
        self.is_configured = False
        #: Numbers of the address that the master has named right, in their order.
        self._matched = self._in_range = 0
        #: The number of the address that the fastscan asks for.
        self._scanned = 0
        self.initialise()

    def initialise(self) -> None:
        """Reset the communication: the newest node-ID counts."""
        self.node_id = self.wanted

    @property
    def is_due(self) -> bool:
        """Whether the node is to boot with its first node-ID: it has one, and has left LSS configuration."""
        return self.node_id == NO_NODE_ID and self.wanted != NO_NODE_ID and not self.is_configured

    def take(self, data: bytes) -> bytes | None:
        """Return the response to a request; None for no response."""
        if len(data) != LSS_BYTES:
            return None
        answer = self._answer(data[0], data)
        return None if answer is None else answer.ljust(LSS_BYTES, b"\0")

    def _answer(self, command: int, data: bytes) -> bytes | None:
        number = int.from_bytes(data[1:5], "little")
        if command == Lss.SWITCH_GLOBAL:
            if data[1] <= 1:
                self.is_configured = bool(data[1])
        elif command in _ADDRESS:
            return self._select(command - Lss.SWITCH_SELECTIVE, number)
        elif command in _RANGES:
            return self._identify(command - Lss.IDENTIFY, number)
        elif command == Lss.IDENTIFY_UNNUMBERED:
            return bytes((Lss.IDENTIFIED_UNNUMBERED,)) if self.wanted == NO_NODE_ID else None
        elif command == Lss.FASTSCAN:
            return self._scan(number, *data[5:8])
        elif self.is_configured:
            return self._configure(command, data)
        return None

    def _select(self, place: int, number: int) -> bytes | None:
        """Switch to configuration when the four numbers of the address have come in their order."""
        if self.is_configured:
            return None
        is_next = place == (self._matched if place else 0)
        self._matched = place + 1 if is_next and number == self._address[place] else 0
        self.is_configured = self._matched == len(self._address)
        if not self.is_configured:
            return None
        self._matched = 0
        return bytes((Lss.SELECTED,))

    def _identify(self, place: int, number: int) -> bytes | None:
        vendor, product, revision, serial = self._address
        fits = (number == vendor, number == product, number <= revision, number >= revision, number <= serial)
        is_right = fits[place] if place < len(fits) else number >= serial
        self._in_range = place + 1 if is_right and place in (0, self._in_range) else 0
        return bytes((Lss.IDENTIFIED,)) if self._in_range == len(_RANGES) else None

    def _scan(self, number: int, bit: int, place: int, following: int) -> bytes | None:
        """Answer if the address agrees down to `bit`; the fastscan goes on with those that agree in all bits."""
        if self.is_configured or self.wanted != NO_NODE_ID:
            return None
        if bit == FASTSCAN_ALL:
            self._scanned = 0
        elif bit > 31 or place > 3 or following > 3 or place != self._scanned or (self._address[place] ^ number) >> bit:
            return None
        elif bit == 0:
            self._scanned = following
            self.is_configured = following < place
        return bytes((Lss.IDENTIFIED,))

    def _configure(self, command: int, data: bytes) -> bytes | None:
        """Answer a request to nodes in the state LSS configuration."""
        answer = b""
        if command == Lss.NODE_ID:
            is_known = data[1] == NO_NODE_ID or data[1] in self._known
            self.wanted = data[1] if is_known else self.wanted
            answer = _error(LssError.NONE if is_known else LssError.NOT_SUPPORTED)
        elif command == Lss.BIT_TIMING:
            rates = LSS_BIT_RATES_HZ if data[1] == 0 else ()
            is_known = self._bit_rate_hz in rates[data[2] : data[2] + 1]
            answer = _error(LssError.NONE if is_known else LssError.NOT_SUPPORTED)
        elif command == Lss.STORE:
            answer = self._save()
        elif command in _INQUIRIES:
            answer = self._address[command - Lss.INQUIRE_ADDRESS].to_bytes(4, "little")
        elif command == Lss.INQUIRE_NODE_ID:
            answer = bytes((self.node_id,))
        return bytes((command,)) + answer if answer else None

    def _save(self) -> bytes:
        try:
            self._store(self.wanted)
        except OSError:
            return _error(LssError.STORAGE)
        self._stored = self.wanted
        return _error(LssError.NONE)


def _error(error: LssError) -> bytes:
    return bytes((error,))
