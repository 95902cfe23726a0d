"""Program download (CiA 302-3) to boards of one bus, one after another: ``skin node update``.

A board has two slots, or one slot and a bootloader that stays: docs/firmware.md, "Program download". Both take the same
steps: stop, clear, download, start. A board that starts in its bootloader takes them, too.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Final

from bus.link import Send
from dbc import indices as od
from dbc.canopen import HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, Abort, NmtCommand, NmtState
from dbc.frame import Frames, one_frame, received
from dbc.program import FlashError, Program, ProgramControl
from gateway.sdo import (
    Download,
    Read,
    SdoAbortedError,
    SdoDialogue,
    SdoError,
    SdoTimeoutError,
    Transfer,
    Write,
    one,
)

#: A board answers within this time, also when it erases its memory or checks a program.
SLOW_S: Final = 5.0
#: A board has started, or has its memory ready, within this time.
BOOT_S: Final = 10.0
#: Pause between two questions whether a board is ready. A gateway leaves a board alone that is asked as often.
PAUSE_S: Final = 0.03
#: Attempts for each board that answers.
ATTEMPTS: Final = 3


@dataclass(frozen=True)
class _Wait:
    """Wait; a boot-up message of the board ends the wait."""

    time_s: float


class _FailedError(Exception):
    """The board cannot get the program; the text says why."""


#: Abort codes that another attempt does not change, in words.
_FINAL: Final[dict[int, str]] = {
    Abort.NO_OBJECT: "the board has no program download",
    Abort.VALUE: "the board does not know the program's header",
    Abort.INCOMPATIBLE: "the board refuses the program as that of another product",
    Abort.TOO_LONG: "the board has no room for the program",
}
#: What a download asks for, and what it gets: a value, an error, or None after a wait or a boot-up message.
_Step = Transfer | _Wait
_Answer = bytes | SdoError | None
_Steps = Generator[_Step, _Answer, str]


@dataclass
class Outcome:
    """What became of one board.

    Attributes
    ----------
    before : int or None
        Identification (1F56h) of the program that ran before; None if the board has not told it.
    after : int or None
        Of the program that runs now.
    result : str
        What was done, or why the board does not run the program.
    """

    before: int | None = None
    after: int | None = None
    result: str = "not reached"


class ProgramUpdate:
    """Loads a program into boards of one bus that do not run it: frames and times in, frames out.

    Parameters
    ----------
    say : callable
        Called with a node-ID and what begins with its board.

    Attributes
    ----------
    outcomes : dict of int to Outcome
        By node-ID.
    done : bool
    due_s : float
        When `tick` has something to do.
    """

    def __init__(
        self,
        program: Program,
        node_ids: Sequence[int],
        send: Send,
        now_s: float,
        *,
        say: Callable[[int, str], None] = lambda *_: None,
    ) -> None:
        self.outcomes = {node_id: Outcome() for node_id in node_ids}
        self.done = False
        self._program = program
        self._image, self._wanted = program.image, program.identification
        self._send, self._say = send, say
        self._left = list(node_ids)
        self._tried = 0
        self._has_booted = False
        self._step: _Step = _Wait(0.0)
        self._dialogue: SdoDialogue | None = None
        self.due_s = now_s
        self._begin_board(now_s)

    @property
    def failed(self) -> list[int]:
        """Node-IDs of boards that do not run the program, as far as is known."""
        return [node_id for node_id, each in self.outcomes.items() if each.after != self._wanted]

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use received frames."""
        for each in received(arrived):
            if self.done:
                return
            can_id, data = int(each["can_id"]), each["data"][: each["length"]].tobytes()
            if can_id == SDO_RESPONSE_BASE + self._node_id and self._dialogue is not None:
                self._dialogue.take(data, now_s)
                self._look(now_s)
            elif can_id == HEARTBEAT_BASE + self._node_id and data == bytes((NmtState.INITIALISING,)):
                self._has_booted = True
                if isinstance(self._step, _Wait | Write):
                    self._go_on(None, now_s)

    def tick(self, now_s: float) -> None:
        """Do what is due."""
        if self.done:
            return
        if self._dialogue is not None:
            self._dialogue.tick(now_s)
            self._look(now_s)
        elif now_s >= self.due_s:
            self._go_on(None, now_s)

    def give_up(self) -> None:
        """End at once: the board in work keeps its program, and waits for another download."""
        if self.done:
            return
        self._send_one(SDO_REQUEST_BASE + self._node_id, b"\x80" + bytes(3) + Abort.TIMEOUT.to_bytes(4, "little"))

    @property
    def _node_id(self) -> int:
        return self._left[0]

    def _begin_board(self, now_s: float) -> None:
        if not self._left:
            self.done = True
            return
        self._tried += 1
        self._steps = self._load()
        self._begin(next(self._steps), now_s)

    def _begin(self, step: _Step, now_s: float) -> None:
        self._step, self._dialogue = step, None
        if isinstance(step, _Wait):
            self.due_s = now_s + step.time_s
            return
        self._has_booted = False
        if isinstance(step, Read):
            self._dialogue = SdoDialogue(self._node_id, one(step), self._send_one, now_s)
        else:  # as long as the memory takes
            self._dialogue = SdoDialogue(self._node_id, one(step), self._send_one, now_s, attempts=1, timeout_s=SLOW_S)
        self.due_s = self._dialogue.due_s

    def _look(self, now_s: float) -> None:
        """Go on when the SDO dialogue has ended."""
        dialogue = self._dialogue
        if dialogue is None:
            return
        self.due_s = dialogue.due_s
        if dialogue.done:
            self._go_on(dialogue.error or (dialogue.result if isinstance(dialogue.result, bytes) else b""), now_s)

    def _go_on(self, came: _Answer, now_s: float) -> None:
        outcome = self.outcomes[self._node_id]
        try:
            step = self._steps.send(came)
        except StopIteration as end:
            outcome.result = end.value
        except _FailedError as error:
            outcome.result = str(error)
        except SdoError as error:
            outcome.result = str(error)
            is_silent = isinstance(error, SdoTimeoutError) and outcome.before is None
            if self._tried < ATTEMPTS and not is_silent:
                self._begin_board(now_s)
                return
        else:
            self._begin(step, now_s)
            return
        self._left.pop(0)
        self._tried = 0
        self._begin_board(now_s)

    def _send_one(self, can_id: int, data: bytes) -> int:
        return self._send(one_frame(can_id, data))

    def _load(self) -> _Steps:
        """Load the program into one board; return what was done."""
        outcome, node_id = self.outcomes[self._node_id], self._node_id
        outcome.after = yield from _number(Read(od.PROGRAM_ID, 1, od.UNSIGNED32))
        if outcome.before is None:
            outcome.before = outcome.after
        if outcome.after == self._wanted:
            return "started" if outcome.before != self._wanted else "has run the program before"
        device = (1, self._program.vendor_id, "vendor-ID"), (2, self._program.product_code, "product code")
        for subindex, number, name in device:
            found = yield from _number(Read(od.IDENTITY, subindex, od.UNSIGNED32))
            if found != number:
                raise _FailedError(f"the program is for boards with the {name} {number:X}h, this one has {found:X}h")
        self._say(node_id, f"{len(self._image)} bytes, attempt {self._tried}")
        # A gateway stops using the node's sums, and leaves the node alone while it is asked often.
        self._send_one(NMT_COB_ID, bytes((NmtCommand.ENTER_PRE_OPERATIONAL, node_id)))
        yield from _control(ProgramControl.STOP)
        for _ in _until_ready():  # its bootloader may start now
            if (yield from _number(Read(od.PROGRAM_CONTROL, 1, od.UNSIGNED8))) != ProgramControl.START:
                break
            yield _Wait(PAUSE_S)
        yield from _control(ProgramControl.CLEAR)
        yield from _ready()
        yield from _value(Download(od.PROGRAM_DATA, 1, self._image))
        if error := (yield from _ready()):
            raise _FailedError(f"the board refuses the program, 1F57h: {_words(error)}")
        yield from _control(ProgramControl.START)
        if not self._has_booted:
            yield _Wait(BOOT_S)
        outcome.after = yield from _number(Read(od.PROGRAM_ID, 1, od.UNSIGNED32))
        if outcome.after != self._wanted:
            raise SdoError("the board has started another program than the new one")
        return "started"


def _until_ready() -> range:
    """Return one entry for each question that a board is asked while it is not ready."""
    return range(round(BOOT_S / PAUSE_S))


def _value(transfer: Transfer) -> Generator[_Step, _Answer, bytes]:
    """Do a transfer; raise its error, `_FailedError` where another attempt is of no use."""
    answer = yield transfer
    if isinstance(answer, SdoAbortedError) and answer.code in _FINAL:
        raise _FailedError(f"{_FINAL[answer.code]} ({answer})")
    if isinstance(answer, SdoError):
        raise answer
    return answer if isinstance(answer, bytes) else b""


def _number(read: Read) -> Generator[_Step, _Answer, int]:
    return int.from_bytes((yield from _value(read)), "little")


def _control(command: ProgramControl) -> Generator[_Step, _Answer, None]:
    """Write 1F51h; a board may reset itself before it has answered."""
    yield from _value(Write(od.PROGRAM_CONTROL, 1, bytes((command,))))


def _ready() -> Generator[_Step, _Answer, int]:
    """Wait until the memory is not busy; return the error of 1F57h."""
    for _ in _until_ready():
        status = yield from _number(Read(od.FLASH_STATUS, 1, od.UNSIGNED32))
        if not status & 1:
            return status >> 1 & 0x7F
        yield _Wait(PAUSE_S)
    raise SdoError(f"the flash memory is busy for more than {BOOT_S:g} s (1F57h)")


def _words(error: int) -> str:
    """Return an error of 1F57h in words."""
    try:
        return FlashError(error).name.lower().replace("_", " ")
    except ValueError:
        return f"error {error}"
