"""A master on an emulated bus: transfers by SDO and program downloads, which a cut of the power may end."""

import select
import time
from collections.abc import Callable
from typing import Final, Protocol

from bus.link import Link
from dbc.canopen import SDO_RESPONSE_BASE
from dbc.frame import Frames, one_frame, received
from gateway.sdo import Read, SdoDialogue, Write, one
from tests.mcu.machine import PATIENCE_S
from tests.processes import Verb

#: Attempts of what a busy machine may disturb: its emulated controllers overrun, and boards are late.
ATTEMPTS: Final = 10


class PowerCutError(Exception):
    """The power has ended."""


class _Talk(Protocol):
    @property
    def done(self) -> bool: ...
    def take(self, arrived: Frames, now_s: float) -> None: ...
    def tick(self, now_s: float) -> None: ...


class Master:
    """Leads talks over a link.

    Attributes
    ----------
    frames_left : int
        Frames until the power is cut.
    """

    def __init__(self, link: Link, cut_power: Callable[[], None]) -> None:
        self.frames_left = 1 << 60
        self._link, self._cut_power = link, cut_power

    def send(self, burst: Frames) -> int:
        """Send frames, or cut the power."""
        self.frames_left -= len(burst)
        if self.frames_left < 0:
            self._cut_power()
            raise PowerCutError
        return self._link.send(burst)

    def lead(self, talk: _Talk, until: Callable[[], bool] = lambda: False) -> None:
        """Lead a talk to its end, or until something is so."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not talk.done and not until():
            assert time.monotonic() < give_up_s, "the talk does not end"
            if select.select([self._link], [], [], 0.002)[0]:
                talk.take(self._link.receive(), time.monotonic())
            talk.tick(time.monotonic())

    def transfer(self, node_id: int, transfer: Read | Write) -> bytes:
        """Read or write an object; on a busy machine frames get lost, and the transfer is repeated."""
        for _ in range(ATTEMPTS):
            talk = _Transfer(node_id, transfer, self.send)
            self.lead(talk)
            if isinstance(talk.dialogue.result, bytes):
                return talk.dialogue.result
        raise AssertionError(talk.dialogue.error)


class _Transfer:
    def __init__(self, node_id: int, transfer: Read | Write, send: Callable[[Frames], int]) -> None:
        self._cob_id: Final = SDO_RESPONSE_BASE + node_id
        now_s = time.monotonic()
        self.dialogue = SdoDialogue(node_id, one(transfer), lambda to, data: send(one_frame(to, data)), now_s)

    @property
    def done(self) -> bool:
        return self.dialogue.done

    def take(self, arrived: Frames, now_s: float) -> None:
        for each in received(arrived):
            if int(each["can_id"]) == self._cob_id:
                self.dialogue.take(each["data"][: each["length"]].tobytes(), now_s)

    def tick(self, now_s: float) -> None:
        self.dialogue.tick(now_s)


def patiently(skin: Verb, *arguments: object) -> None:
    """Run a command until it succeeds."""
    failed = []
    for _ in range(ATTEMPTS):
        code, said, errors = skin(*arguments)
        if code == 0:
            return
        failed.append(said + errors)
    raise AssertionError("\n".join(failed))
