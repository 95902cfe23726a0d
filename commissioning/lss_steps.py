"""The steps of a master of LSS (CiA 305) on one bus: frames and times in, frames out.

The work on the bus is a generator of steps, as in `commissioning.node_check`. Several boards answer one request, each
in its own time: a step waits out `WINDOW_S`, and counts the answers. Two answers to what one board alone may answer are
two boards with one serial number, or with one node-ID. Boards whose answers are always sent in the same bit are one
board on the bus.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Final, cast

from bus.link import Send
from dbc.canopen import (
    FASTSCAN_ALL,
    HIGHEST_NODE_ID,
    LSS_BYTES,
    LSS_REQUEST_COB_ID,
    LSS_RESPONSE_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    Lss,
    LssError,
)
from dbc.configuration import DIALOGUES
from dbc.frame import ECHO, ERROR, Frames, one_frame, received
from dbc.lss import fastscan, lss_request
from gateway.sdo import Dialogue, SdoDialogue

#: Longest time in which a board answers a request that several boards may answer.
WINDOW_S: Final = 0.03
#: Pause after a request that nobody answers: a small board takes one request at a time.
GAP_S: Final = 0.002
#: Longest wait for a board that has been selected: it may write flash memory, or boot.
SELECTED_S: Final = 2.0
#: Longest time in which a board resets its communication.
RESET_S: Final = 0.2

TWO_SERIALS: Final = "two boards answer: they have one serial number"

Address = tuple[int, int, int, int]


@dataclass(frozen=True)
class Ask:
    """Send a frame, and get the answers: frames with `reply_id` whose payload begins with `begins`."""

    can_id: int
    data: bytes
    begins: bytes = b""
    wait_s: float = WINDOW_S
    reply_id: int = LSS_RESPONSE_COB_ID


@dataclass(frozen=True)
class Talk:
    """Lead SDO dialogues with several nodes at once, and get a `Talked` for each."""

    dialogues: dict[int, Dialogue]
    attempts: int = 3


@dataclass
class Talked:
    """A dialogue, and the numbers of its requests and answers."""

    dialogue: SdoDialogue
    asked: int = 0
    answered: int = 0


Step = Ask | Talk
Answer = list[bytes] | dict[int, Talked]
Steps = Generator[Step, Answer, None]


class TroubleError(Exception):
    """A board cannot be commissioned."""


class RefusedError(TroubleError):
    """A board answers a request of LSS with an error code."""


class LssSteps:
    """Does the steps of `_work` on one bus.

    Attributes
    ----------
    done : bool
    due_s : float
        When `tick` has something to do.
    error_frames : int
        Error frames on the bus: boards at another bit rate cause them.
    strangers : list of str
        What else is on the bus, in words, and why nothing was done.
    """

    def __init__(self, send: Send, now_s: float) -> None:
        self._send = send
        self.strangers: list[str] = []
        self.done = False
        self.error_frames = 0
        self._has_sync = False
        self._now_s = now_s
        #: Dialogues that wait: the transmit queue of an interface has little room.
        self._waiting: list[tuple[int, Dialogue]] = []
        self._step: Step | None = None
        self._began_s = self._ends_s = now_s
        self._answers: list[bytes] = []
        self._talked: dict[int, Talked] = {}
        self._steps = self._work()
        self._begin(next(self._steps), now_s)

    def _work(self) -> Steps:
        raise NotImplementedError

    # Frames and time

    @property
    def due_s(self) -> float:
        """When the open step ends, as things stand; that of dialogues is not known."""
        return float("inf") if self._talked else self._ends_s

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use received frames."""
        self.error_frames += int((arrived["flags"] & (ERROR | ECHO) == ERROR).sum())
        for each in received(arrived):
            can_id, data = int(each["can_id"]), each["data"][: each["length"]].tobytes()
            self._has_sync |= can_id == SYNC_COB_ID
            if isinstance(self._step, Ask):
                is_whole = can_id != LSS_RESPONSE_COB_ID or len(data) == LSS_BYTES
                if can_id == self._step.reply_id and is_whole and data.startswith(self._step.begins):
                    self._answers.append(data)
                    self._ends_s = min(self._ends_s, max(now_s, self._began_s + WINDOW_S))
            elif can_id & ~HIGHEST_NODE_ID == SDO_RESPONSE_BASE and can_id & HIGHEST_NODE_ID in self._talked:
                talked = self._talked[can_id & HIGHEST_NODE_ID]
                talked.answered += 1
                talked.dialogue.take(data, now_s)

    def tick(self, now_s: float) -> None:
        """Do what is due."""
        self._now_s = now_s
        if self.done:
            return
        for each in self._talked.values():
            each.dialogue.tick(now_s)
        if isinstance(self._step, Talk):
            self._open_dialogues(self._step, now_s)
            if not all(each.dialogue.done for each in self._talked.values()):
                return
        elif now_s < self._ends_s:
            return
        came: Answer = self._talked if isinstance(self._step, Talk) else self._answers
        try:
            step = self._steps.send(came)
        except StopIteration:
            self.done = True
        else:
            self._begin(step, now_s)

    def give_up(self) -> None:
        """End at once; no board stays in the state LSS configuration."""
        self._steps.close()
        self.done = True
        self._send_one(LSS_REQUEST_COB_ID, lss_request(Lss.SWITCH_GLOBAL))

    def _begin(self, step: Step, now_s: float) -> None:
        self._step, self._began_s, self._answers, self._talked = step, now_s, [], {}
        if isinstance(step, Ask):
            self._ends_s = now_s + step.wait_s
            if step.can_id or step.data:
                self._send_one(step.can_id, step.data)
            return
        self._waiting = [*step.dialogues.items()]
        self._open_dialogues(step, now_s)

    def _open_dialogues(self, step: Talk, now_s: float) -> None:
        """Begin the dialogues that wait, up to `DIALOGUES` at once."""
        free = DIALOGUES - sum(not each.dialogue.done for each in self._talked.values())
        for node_id, steps in self._waiting[:free]:
            dialogue = SdoDialogue(node_id, steps, self._send_one, now_s, attempts=step.attempts)
            self._talked[node_id] = Talked(dialogue, asked=1)
        del self._waiting[:free]

    def _send_one(self, can_id: int, data: bytes) -> None:
        node_id = can_id - SDO_REQUEST_BASE
        if node_id in self._talked:
            self._talked[node_id].asked += 1
        self._send(one_frame(can_id, data))

    # Requests of LSS

    def _all_waiting(self) -> Steps:
        yield Ask(LSS_REQUEST_COB_ID, lss_request(Lss.SWITCH_GLOBAL), wait_s=GAP_S)

    def _select(self, address: Address) -> Generator[Step, Answer, bool]:
        """Switch the board at an address to configuration; tell whether there is one."""
        *first, last = (
            lss_request(Lss.SWITCH_SELECTIVE + place, *number.to_bytes(4, "little"))
            for place, number in enumerate(address)
        )
        for each in first:
            yield Ask(LSS_REQUEST_COB_ID, each, wait_s=GAP_S)
        came = yield Ask(LSS_REQUEST_COB_ID, last, bytes((Lss.SELECTED,)))
        if len(came) > 1:
            raise TroubleError(TWO_SERIALS)
        return bool(came)

    def _configure(self, command: Lss, *values: int, what: str = "a request") -> Generator[Step, Answer, bytes]:
        """Ask the selected board, and return its answer; no answer, two, or an error code is trouble."""
        came = cast(
            "list[bytes]",
            (yield Ask(LSS_REQUEST_COB_ID, lss_request(command, *values), bytes((command,)), SELECTED_S)),
        )
        if not came:
            raise TroubleError(f"stopped answering at {what}")
        if len(came) > 1:
            raise TroubleError(TWO_SERIALS)
        if command != Lss.INQUIRE_NODE_ID and came[0][1]:
            why = "not supported" if came[0][1] == LssError.NOT_SUPPORTED else f"error {came[0][1]}"
            raise RefusedError(f"refuses {what}: {why}")
        return came[0]

    def _unnumbered(self) -> Generator[Step, Answer, dict[Address, int]]:
        """Find the addresses of boards without node-ID, and count the boards of each."""
        found: dict[Address, int] = {}
        if (yield scan(0, FASTSCAN_ALL, 0, 0)):
            try:
                yield from self._fastscan((), found)
            except TroubleError as trouble:
                self.strangers.append(str(trouble))
            else:
                if not found:
                    self.strangers.append("boards without node-ID answer, but the fastscan finds none: run it again")
        return found

    def _fastscan(self, path: tuple[int, ...], found: dict[Address, int]) -> Steps:
        """Find the addresses that begin with the numbers `path`, of boards without node-ID, and count their boards.

        No board changes its state: in LSS configuration CANopenNode would answer every request of a fastscan.
        """
        place, begun = len(path), [(0, 32)]
        yield scan(0, FASTSCAN_ALL, 0, 0)
        for before, number in enumerate(path):
            yield scan(number, 0, before, before + 1)
        numbers: dict[int, int] = {}
        while begun:
            high, bits = begun.pop()
            if len(begun) + len(numbers) > HIGHEST_NODE_ID:
                raise TroubleError(_ANSWERS_ALL)
            for number in (high | 1 << bits - 1, high):
                count = len((yield scan(number, bits - 1, place, place)))
                if count and bits > 1:
                    begun.append((number, bits - 1))
                elif count:
                    numbers[number] = count
        for number, count in numbers.items():
            if place == 3:
                vendor, product, revision = path
                found[vendor, product, revision, number] = count
            else:
                yield from self._fastscan((*path, number), found)


_ANSWERS_ALL: Final = "a device answers every request of the fastscan: take it off the bus, then commission again"


def scan(number: int, bit: int, place: int, following: int) -> Ask:
    """Ask boards without node-ID whether `number` is theirs down to `bit`, see `dbc.lss.fastscan`."""
    return Ask(LSS_REQUEST_COB_ID, fastscan(number, bit, place, following), bytes((Lss.IDENTIFIED,)))
