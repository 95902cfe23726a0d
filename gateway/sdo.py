"""SDO transfers of a client as a state machine (CiA 301, 7.2.4): frames in, frames out, time as an argument.

The client of the ``canopen`` library blocks a thread until the answer comes. The gateway asks many nodes at once and
must not block. A dialogue with a node is a generator: it yields a `Transfer`, and receives the answer.
"""

import binascii
import struct
from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Final, cast

from dbc.canopen import (
    FIRST_ABORT_OF_THE_OBJECT,
    SDO_BLOCK_TAKEN,
    SDO_BLOCKS_BEGUN,
    SDO_BLOCKS_TAKEN,
    SDO_BYTES,
    SDO_REQUEST_BASE,
    Abort,
)
from dbc.contract import LONGEST_VALUE
from dbc.values import value_bytes

#: Time limit of an answer. Answers wait for the whole burst of sums: less than one period, 10 ms at 100 Hz.
TIMEOUT_S: Final = 0.3
#: Attempts of a transfer before the node counts as not answering.
ATTEMPTS: Final = 3

#: Blocks of a download in a row whose first segment is lost; then the download begins anew.
MOST_LOST: Final = 10
#: When a full transmit queue is tried again: three frames at 1 Mbit/s.
ROOM_S: Final = 0.0004

_TOGGLE: Final = 0x10
#: The command of an abort, in the three highest bits.
_ABORTED: Final = 0x80
#: Most segments of a block.
_MOST_SEGMENTS: Final = 127
#: Bytes of a segment.
_SEGMENT: Final = 7
#: The bits that count of the first bytes of answers to a block download.
_BLOCK_BITS: Final = 0xE3


@dataclass(frozen=True)
class Read:
    """Upload of one object; `data_type` tells which bytes of the answer are the value (`dbc.values.value_bytes`)."""

    index: int
    subindex: int
    data_type: int

    @property
    def request(self) -> bytes:
        """Payload of the request."""
        return b"\x40" + self.index.to_bytes(2, "little") + bytes((self.subindex,)) + bytes(4)


@dataclass(frozen=True)
class Write:
    """Expedited download of one object: `data` has 1 to 4 bytes."""

    index: int
    subindex: int
    data: bytes

    @property
    def request(self) -> bytes:
        """Payload of the request."""
        command = 0x23 | 4 - len(self.data) << 2
        return struct.pack("<BHB4s", command, self.index, self.subindex, self.data)


@dataclass(frozen=True)
class Download:
    """Download of any length: in blocks with CRC, or in segments, also to a node without block transfer."""

    index: int
    subindex: int
    data: bytes
    in_blocks: bool = True


Transfer = Read | Write | Download
#: Yields requests of a download, receives an answer.
_Requests = Generator[Sequence[bytes], bytes, None]
#: Yields transfers, receives the value read (empty after a write), and returns a result.
Dialogue = Generator[Transfer, bytes, "object"]


def one(transfer: Transfer) -> Dialogue:
    """Do one transfer; the result is the value read."""
    return (yield transfer)


class SdoError(Exception):
    """A transfer failed."""


class SdoTimeoutError(SdoError):
    """The node answered none of the attempts; the last of what came instead is named."""


class SdoAbortedError(SdoError):
    """The node aborted the transfer, or its answer is no value; `code` is the abort code (CiA 301, table 22)."""

    def __init__(self, transfer: Transfer, code: int, words: str = "") -> None:
        super().__init__(f"object {transfer.index:04X}h:{transfer.subindex}: {words or _abort_text(code)}")
        self.code = code


def _abort_text(code: int) -> str:
    try:
        words = Abort(code).name.lower().replace("_", " ")
    except ValueError:
        from canopen.sdo.exceptions import SdoAbortedError as Known

        words = Known.CODES.get(code, "").lower()
    return f"abort {code:08X}h{', ' * bool(words)}{words}"


class SdoDialogue:
    """One dialogue with one node.

    Parameters
    ----------
    steps : generator
        The dialogue; a failed transfer raises `SdoError` inside the generator.
    send : callable
        Sends a frame: COB-ID and data; returns 0 if the transmit queue is full. Other requests than those of downloads
        then count as lost.
    timeout_s : float
        Time limit of an answer.

    Attributes
    ----------
    done : bool
    due_s : float
        When `tick` has something to do.
    result : object
        Return value of the generator.
    error : SdoError or None
        Error that the generator did not catch.
    asked_s : float
        When the newest transfer began.
    """

    def __init__(
        self,
        node_id: int,
        steps: Dialogue,
        send: Callable[[int, bytes], int | None],
        now_s: float,
        *,
        attempts: int = ATTEMPTS,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self.done = False
        self.result: object = None
        self.error: SdoError | None = None
        self.asked_s = now_s
        self._cob_id = SDO_REQUEST_BASE + node_id
        self._steps = steps
        self._send = send
        self._attempts = attempts
        self._timeout_s = timeout_s
        self._transfer: Transfer = Read(0, 0, 0)
        self._tried = 0
        self._value: bytearray | None = None
        #: Of an upload in segments: the bytes that the node has told, 0 if none.
        self._told = self._toggle = 0
        #: The newest answer that is none to the transfer, in words.
        self._unused = ""
        #: Of a download: its requests, those that have found no room yet, and whether blocks are refused.
        self._requests: _Requests | None = None
        self._waiting: deque[bytes] = deque()
        self._in_segments = False
        self.due_s = self._limit_s = float("inf")
        self._go_on(lambda: next(steps), now_s)

    @property
    def requested_s(self) -> float:
        """When the newest request was sent."""
        return self._limit_s - self._timeout_s

    def tick(self, now_s: float) -> None:
        """Repeat the transfer when its answer is overdue, and go on with a download when there is room."""
        if self._waiting and now_s < self._limit_s:
            self._send_waiting(now_s)
        if self.done or now_s < self._limit_s:
            return
        self._waiting.clear()
        self._abort(Abort.TIMEOUT)
        self._retry(now_s)

    def take(self, data: bytes, now_s: float) -> None:
        """Use an answer of the node; answers to another client are only named when no other comes."""
        if self.done:
            return
        if why := self._why_unused(data):
            self._unused = f" but {data.hex().upper()}, {why}"
        elif data[0] & 0xE0 == _ABORTED:
            self._aborted(data, now_s)
        elif self._requests is not None:
            self._go_on_with(self._requests, data, now_s)
        elif isinstance(self._transfer, Write):
            self._answered(b"", now_s)
        elif self._value is None:
            self._begun(data, now_s)
        else:
            self._segment(self._value, data, now_s)

    def _why_unused(self, data: bytes) -> str:
        """Tell why a frame is no answer to the newest request, empty if it is one."""
        if len(data) != SDO_BYTES:
            return f"which has {len(data)} bytes, not {SDO_BYTES}"
        kind, is_upload = data[0] & 0xE0, self._requests is None and isinstance(self._transfer, Read)
        if is_upload and self._value is not None and kind == 0:
            return "" if data[0] & _TOGGLE == self._toggle else "which has the wrong toggle bit"
        if self._requests is not None and kind != _ABORTED:
            return ""
        if kind != _ABORTED and (self._value is not None or kind != (0x40 if is_upload else 0x60)):
            return "which answers another request"
        if not self._is_mine(data) and (kind != _ABORTED or any(data[1:4])):
            return f"which is of object {int.from_bytes(data[1:3], 'little'):04X}h:{data[3]}"
        return ""

    def ask_again(self, data: bytes, now_s: float) -> None:
        """Repeat a read at once if `data`, which must not be used, answers it; the attempt does not count."""
        if not self.done and isinstance(self._transfer, Read) and self._value is None and self._is_mine(data):
            self._tried -= 1
            self._begin(now_s)

    def _is_mine(self, data: bytes) -> bool:
        return (int.from_bytes(data[1:3], "little"), data[3]) == (self._transfer.index, self._transfer.subindex)

    def _begun(self, data: bytes, now_s: float) -> None:
        if data[0] & 0x02:  # expedited
            unused = data[0] >> 2 & 0x03 if data[0] & 0x01 else 0
            self._came(data[4 : SDO_BYTES - unused], now_s, has_size=bool(data[0] & 0x01))
            return
        self._value, self._toggle = bytearray(), 0
        self._told = int.from_bytes(data[4:], "little") if data[0] & 0x01 else 0
        self._ask_segment(now_s)

    def _came(self, data: bytes, now_s: float, *, has_size: bool = True) -> None:
        """Go on with the value in the bytes of an upload."""
        why = f"expected the {self._told} bytes that the node has told, got {len(data)}"
        if self._told in (0, len(data)):
            try:
                value = value_bytes(cast("Read", self._transfer).data_type, data, has_size=has_size)
            except ValueError as error:
                why = str(error)
            else:
                self._answered(value, now_s)
                return
        self._fail(SdoAbortedError(self._transfer, Abort.LENGTH, why), now_s)

    def _segment(self, value: bytearray, data: bytes, now_s: float) -> None:
        came = data[1 : SDO_BYTES - (data[0] >> 1 & 0x07)]
        value += came
        if data[0] & 0x01:
            self._came(bytes(value), now_s)
        elif not came or len(value) > LONGEST_VALUE:  # a transfer without end
            self._abort(Abort.MEMORY)
            self._fail(SdoAbortedError(self._transfer, Abort.MEMORY), now_s)
        else:
            self._toggle ^= _TOGGLE
            self._ask_segment(now_s)

    def _go_on_with(self, requests: _Requests, answer: bytes, now_s: float) -> None:
        """Pass an answer to a download, and send what follows."""
        try:
            following = requests.send(answer)
        except StopIteration:
            self._answered(b"", now_s)
            return
        except SdoError:  # no block comes whole
            self._abort(Abort.TIMEOUT)
            self._retry(now_s)
            return
        if following:
            self._waiting, self._unused = deque(following), ""
            self._send_waiting(now_s)
        else:
            self._unused = f" but {answer.hex().upper()}, which answers another request"

    def _send_waiting(self, now_s: float) -> None:
        """Send requests of a download while there is room; the time limit begins anew with each."""
        while self._waiting and self._send(self._cob_id, self._waiting[0]) != 0:
            self._waiting.popleft()
            self._limit_s = now_s + self._timeout_s
        self.due_s = min(now_s + ROOM_S, self._limit_s) if self._waiting else self._limit_s

    def _ask_segment(self, now_s: float) -> None:
        self.due_s = self._limit_s = now_s + self._timeout_s
        self._unused = ""
        self._send(self._cob_id, bytes((0x60 | self._toggle, 0, 0, 0, 0, 0, 0, 0)))

    def _aborted(self, data: bytes, now_s: float) -> None:
        code = int.from_bytes(data[4:8], "little")
        is_download, self._waiting = self._requests is not None, deque()
        if is_download and code == Abort.COMMAND and not self._in_segments:
            self._in_segments = True  # the node has no block download
            self._begin(now_s)
        elif code < FIRST_ABORT_OF_THE_OBJECT:
            self._unused = f" but {_abort_text(code)}"
            self._retry(now_s)  # the transfer failed, not the access to the object
        else:
            self._fail(SdoAbortedError(self._transfer, code), now_s)

    def _retry(self, now_s: float) -> None:
        if self._tried >= self._attempts:
            index, subindex = self._transfer.index, self._transfer.subindex
            self._fail(SdoTimeoutError(f"no answer to object {index:04X}h:{subindex}{self._unused}"), now_s)
        else:
            self._begin(now_s)

    def _begin(self, now_s: float) -> None:
        self._tried += 1
        self.asked_s = now_s
        self._value = self._requests = None
        self._told = 0
        self.due_s = self._limit_s = now_s + self._timeout_s
        to = self._transfer
        if isinstance(to, Download):
            place = to.index.to_bytes(2, "little") + bytes((to.subindex,))
            begin = _in_blocks if to.in_blocks and not self._in_segments else _in_segments
            self._requests = begin(place, to.data)
            self._waiting = deque(next(self._requests))
            self._send_waiting(now_s)
        else:
            self._send(self._cob_id, to.request)

    def _abort(self, code: int) -> None:
        place = self._transfer.index.to_bytes(2, "little") + bytes((self._transfer.subindex,))
        self._send(self._cob_id, b"\x80" + place + code.to_bytes(4, "little"))

    def _answered(self, value: bytes, now_s: float) -> None:
        self._go_on(lambda: self._steps.send(value), now_s)

    def _fail(self, error: SdoError, now_s: float) -> None:
        self._go_on(lambda: self._steps.throw(error), now_s)

    def _go_on(self, step: Callable[[], Transfer], now_s: float) -> None:
        try:
            self._transfer = step()
        except StopIteration as end:
            self.done, self.result = True, end.value
        except SdoError as error:
            self.done, self.error = True, error
        else:
            self._tried, self._unused = 0, ""
            self._begin(now_s)


def _in_blocks(place: bytes, data: bytes) -> _Requests:
    """Download in blocks (CiA 301, 7.2.4.3.9 to 7.2.4.3.11), with the CRC of 7.2.4.3.16."""
    answer = yield [b"\xc6" + place + len(data).to_bytes(4, "little")]
    while answer[0] & _BLOCK_BITS != SDO_BLOCKS_BEGUN or answer[1:4] != place:
        answer = yield ()
    at, most, idle = 0, min(answer[4], _MOST_SEGMENTS), 0
    while at < len(data):
        segments = range(at, min(at + _SEGMENT * most, len(data)), _SEGMENT)
        answer = yield [
            bytes((number | 0x80 * (first + _SEGMENT >= len(data)),)) + data[first : first + _SEGMENT].ljust(7, b"\0")
            for number, first in enumerate(segments, 1)
        ]
        while answer[0] & _BLOCK_BITS != SDO_BLOCK_TAKEN or answer[1] > len(segments):
            answer = yield ()
        # What came behind a gap is sent again.
        at, most, idle = at + _SEGMENT * answer[1], min(answer[2], _MOST_SEGMENTS), 0 if answer[1] else idle + 1
        if idle > MOST_LOST:
            raise SdoError
    unused = -len(data) % _SEGMENT
    answer = yield [bytes((0xC1 | unused << 2,)) + binascii.crc_hqx(data, 0).to_bytes(2, "little") + bytes(5)]
    while answer[0] & _BLOCK_BITS != SDO_BLOCKS_TAKEN:
        answer = yield ()


def _in_segments(place: bytes, data: bytes) -> _Requests:
    """Download in segments (CiA 301, 7.2.4.3.3 and 7.2.4.3.4)."""
    answer = yield [b"\x21" + place + len(data).to_bytes(4, "little")]
    while answer[0] != 0x60 or answer[1:4] != place:
        answer = yield ()
    for number, at in enumerate(range(0, len(data), _SEGMENT)):
        part, toggle = data[at : at + _SEGMENT], _TOGGLE * (number % 2)
        is_last = at + _SEGMENT >= len(data)
        answer = yield [bytes((toggle | (_SEGMENT - len(part)) << 1 | is_last,)) + part.ljust(_SEGMENT, b"\0")]
        while answer[0] & 0xF0 != 0x20 | toggle:
            answer = yield ()
