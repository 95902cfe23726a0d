"""One turn of a command that talks with the nodes of one or several buses."""

import select
import time
from collections.abc import Mapping
from typing import Final, Protocol, TypeVar

from bus.link import Link
from dbc.frame import Frames

#: Longest wait for frames in one turn.
TURN_S: Final = 0.01

_Bus = TypeVar("_Bus")


class Talk(Protocol):
    """A talk on one bus: frames and times in."""

    @property
    def done(self) -> bool:
        """Whether the talk is over."""

    @property
    def due_s(self) -> float:
        """When `tick` has something to do."""

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use received frames."""

    def tick(self, now_s: float) -> None:
        """Do what is due."""


def take_turn(links: Mapping[_Bus, Link], talks: Mapping[_Bus, Talk]) -> None:
    """Wait until frames come, a talk is due or `TURN_S` is over; give each talk its frames and the time."""
    due_s = min(each.due_s for each in talks.values() if not each.done)
    select.select([*links.values()], [], [], min(TURN_S, max(0.0, due_s - time.monotonic())))
    for bus, link in links.items():
        talks[bus].take(link.receive(), time.monotonic())
        talks[bus].tick(time.monotonic())
