"""The steps of a check of one board: pauses, SDO transfers, and cycles of SYNC; frames and times in, frames out.

SYNC goes on at the layout's period from `_begin_sync` on: a stock stack leaves OPERATIONAL when no SYNC comes for 1.5
periods. The work is a generator of steps, as in `commissioning.lss_steps`.
"""

from collections.abc import Generator
from dataclasses import dataclass
from typing import Final, cast

import numpy as np

from bus.link import Send
from commissioning.node_frames import SETTLING, ExpectedFrames, syncs_of
from dbc.canopen import NMT_COB_ID, SDO_RESPONSE_BASE, SYNC_COB_ID, NmtCommand
from dbc.contract import NodeContract
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames, frames, one_frame
from gateway.sdo import SdoDialogue, SdoError, Transfer, one
from skin.sync_counter import SYNC_OVERFLOW

#: Longest wait for the SYNC after the last cycle: the frames of a busy computer come late, but not late on the bus.
LAST_SYNC_S: Final = 0.5


@dataclass(frozen=True)
class Listen:
    """Wait, and get the frames that came."""

    time_s: float


@dataclass(frozen=True)
class Cycles:
    """Send a frame, let `SETTLING` SYNC messages pass, and get the frames up to the SYNC after the cycles."""

    can_id: int
    data: bytes


#: What a check asks for, and what it gets: frames, the value of an object, or an error.
Step = Listen | Transfer | Cycles
Answer = Frames | bytes | SdoError
Steps = Generator[Step, Answer, None]


class CheckSteps:
    """Does the steps of `_work` with one board.

    Parameters
    ----------
    expected : ExpectedFrames
        Gets all frames of the bus, and tells how many cycles each picture needs.
    period_s : float
        Time from SYNC to SYNC.
    idle : int
        Counter of a SYNC at which no board begins to count.

    Attributes
    ----------
    done : bool
    due_s : float
        When `tick` has something to do.
    """

    def __init__(
        self, node: NodeContract, expected: ExpectedFrames, send: Send, now_s: float, *, period_s: float, idle: int
    ) -> None:
        self._node, self._expected, self._period_s, self._send = node, expected, period_s, send
        self.done = False
        #: When the next SYNC goes; infinite before the first pattern.
        self._sync_s = np.inf
        self._counter = self._idle = idle
        self._heard: list[Frames] = []
        self._dialogue: SdoDialogue | None = None
        #: When the open step ends; infinite where that depends on what comes.
        self._ends_s = self.due_s = now_s
        #: SYNC messages that the cycles of a pattern still need; None outside the cycles.
        self._wanted: int | None = None
        self._begun: Cycles | None = None
        self._steps = self._work()
        self._begin(next(self._steps), now_s)

    def _work(self) -> Steps:
        raise NotImplementedError

    def _restore(self) -> Steps:
        raise NotImplementedError

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use received frames, with the echoes of own frames."""
        arrived = arrived[(arrived["flags"] & (ERROR | REMOTE | EXTENDED)) == 0]
        if self.done or not len(arrived):
            return
        self._heard.append(arrived)
        self._expected.hear(arrived)
        answers = arrived[
            (arrived["can_id"] == SDO_RESPONSE_BASE + self._node.node_id) & (arrived["flags"] & ECHO == 0)
        ]
        for each in answers:
            if self._dialogue is not None:
                self._dialogue.take(each["data"][: each["length"]].tobytes(), now_s)
        self._look(now_s)

    def tick(self, now_s: float) -> None:
        """Do what is due."""
        if self.done:
            return
        if now_s >= self._sync_s:
            self._sync(now_s)
        if self._dialogue is not None:
            self._dialogue.tick(now_s)
            self._look(now_s)
        elif now_s >= self._ends_s or self._has_all_cycles():
            self._go_on(np.concatenate([frames(0), *self._heard]), now_s)
        self.due_s = min(self._ends_s, self._sync_s)

    def _sync(self, now_s: float) -> None:
        """Send a SYNC; in the cycles of a pattern the counter is the number of the cycle, else no start value.

        Stepped boards have no start value, and their slots count on.
        """
        self._send_one(SYNC_COB_ID, bytes((self._counter,)))
        self._counter = self._counter + 1 if self._counter < SYNC_OVERFLOW else self._idle
        if self._wanted is not None:
            self._wanted -= 1
            if self._wanted == self._expected.cycles + 1 and not self._node.in_steps:
                self._counter = 1
            elif self._wanted == 0:
                self._ends_s = now_s + LAST_SYNC_S
        period_s = self._period_s
        self._sync_s += period_s
        if self._sync_s <= now_s:  # no two SYNC messages at once after a pause of this computer
            self._sync_s = now_s + period_s

    def _has_all_cycles(self) -> bool:
        """Tell whether the SYNC after the last cycle was on the bus: what belongs to the cycles came before it."""
        if self._wanted != 0:
            return False
        syncs = syncs_of(self._since_begin(np.concatenate([frames(0), *self._heard])))
        return len(syncs) > SETTLING + self._expected.cycles

    def give_up(self, now_s: float) -> None:
        """Put back what was written, and end then."""
        self._dialogue = None
        self._steps = self._restore()
        self._go_on(None, now_s)

    def _look(self, now_s: float) -> None:
        """Go on when the SDO dialogue has ended."""
        if self._dialogue is None or not self._dialogue.done:
            return
        ended, self._dialogue = self._dialogue, None
        self._go_on(ended.error or cast("bytes", ended.result), now_s)

    def _go_on(self, came: Answer | None, now_s: float) -> None:
        try:
            step = self._steps.send(cast("Answer", came))  # None begins the steps
        except StopIteration:
            self.done = True
        else:
            self._begin(step, now_s)

    def _begin(self, step: Step, now_s: float) -> None:
        self._heard.clear()
        self._wanted = None
        if isinstance(step, Listen):
            self._ends_s = now_s + step.time_s
        elif isinstance(step, Cycles):
            self._send_one(step.can_id, step.data)
            self._begun = step
            self._ends_s, self._wanted = np.inf, SETTLING + self._expected.cycles + 1
        else:
            self._ends_s = np.inf
            self._dialogue = SdoDialogue(self._node.node_id, one(step), self._send_one, now_s)
        self.due_s = min(self._ends_s, self._sync_s)

    def _send_one(self, can_id: int, data: bytes) -> None:
        self._send(one_frame(can_id, data))

    def _nmt(self, command: NmtCommand) -> None:
        self._send_one(NMT_COB_ID, bytes((command, self._node.node_id)))

    def _begin_sync(self) -> None:
        self._sync_s = -np.inf

    def _since_begin(self, came: Frames) -> Frames:
        """Return the frames from the newest echo of the frame that began the cycles on, none if that was not sent."""
        begun = self._begun
        if begun is None:
            return came[:0]
        is_begin = (came["can_id"] == begun.can_id) & (came["flags"] & ECHO != 0)
        is_begin &= (came["data"][:, : len(begun.data)] == np.frombuffer(begun.data, np.uint8)).all(axis=1)
        begins = np.flatnonzero(is_begin)
        return came[begins[-1] :] if begins.size else came[:0]
