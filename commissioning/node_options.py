"""Which node a verb of ``skin node`` is for, and how a talk with it is led."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cyclopts import Parameter

from bus.link import Link
from canskin.errors import InputError, RunError
from commissioning.talk import Talk, take_turn
from dbc.canopen import HIGHEST_NODE_ID
from dbc.contract import Contract, NodeContract
from shell.service import StopSignal
from shell.skin_options import SkinOptions
from skin.layout import Layout
from skin.ranges import ranges_text


@Parameter(name="*")
@dataclass(frozen=True)
class NodeOptions:
    """Which node.

    Attributes
    ----------
    node
        Node-ID of the board or device. ``reset``, ``stop``, ``start``: without it all nodes of the bus.
    bus
        Name of its bus in the layout. Default: the only one.
    layout
        TOML of the skin; default: the layout that a hub tells, else the default skin.
    connect
        Endpoint of the hub; default: that of this machine.
    """

    node: int | None = None
    bus: str | None = None
    layout: Path | None = None
    connect: str | None = None

    def load(self) -> Layout:
        """Return the skin; raise InputError for a node-ID that no CANopen device has."""
        if self.node is not None and not 1 <= self.node <= HIGHEST_NODE_ID:
            raise InputError(f"expected --node with a node-ID from 1 to {HIGHEST_NODE_ID}, got {self.node}")
        return SkinOptions(self.layout, self.connect).find(needs_hub=False)

    def bus_number(self, skin: Layout) -> int:
        """Return the number of the bus in the layout."""
        names = [bus.name for bus in skin.bus]
        if self.bus is None and len(names) == 1:
            return 0
        if self.bus not in names:
            got = "none" if self.bus is None else f"'{self.bus}'"
            raise InputError(f"expected --bus with one of {', '.join(names)}, got {got}")
        return names.index(self.bus)

    def board(self, contract: Contract) -> NodeContract:
        """Return the board of the skin that is meant."""
        number = self.bus_number(contract.layout)
        for each in contract.on_bus(number):
            if each.node_id == self.node:
                return each
        line = contract.layout.bus[number]
        raise InputError(f"expected a node-ID of {line.name}, {ranges_text(line.ids)}, got {self.node}")


class NodeTalk(Talk, Protocol):
    """A talk with a node: a check, or transfers; `give_up` has it put back what it wrote, and end."""

    def give_up(self, now_s: float) -> None:
        """End, as soon as what was written is put back."""


def lead(talk: NodeTalk, link: Link, stop: StopSignal) -> None:
    """Lead a talk to its end; raise RunError if it was stopped before."""
    is_stopped = False
    while not talk.done:
        if stop.is_set() and not is_stopped:
            is_stopped = True
            talk.give_up(time.monotonic())
        else:
            take_turn({0: link}, {0: talk})
    if is_stopped:
        raise RunError("stopped before the talk with the node was over")
