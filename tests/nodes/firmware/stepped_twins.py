"""Stepped boards of one bus twice, in Python and in C: the same samples, frames, and fates of their frames."""

from pathlib import Path
from typing import Any

import numpy as np

from bus.link import DISCARDED
from dbc.contract import Contract
from dbc.frame import ECHO, frames
from skin.layout import load_layout
from skin.sources import Frame
from tests.layouts import small_boards
from tests.nodes.firmware.twins import Twins

#: Boards of 32 taxels, and of other sizes; some places of the mats of 10 x 10 are empty.
SKINS = {
    "steps": lambda: load_layout(Path("steps")),
    "steps-fd": lambda: load_layout(Path("steps-fd")),
    "8": lambda: small_boards(8),
    "16": lambda: small_boards(16, 10, 10),
    "64": lambda: small_boards(64),
    "64-fd": lambda: small_boards(64, 10, 10, fd=True, data_bitrate=5_000_000),
}
#: Steps of 10 ms after which the touches come again.
STROKES_STEPS = 200


def contract_of(name: str) -> Contract:
    """Return the contract of one of `SKINS`."""
    return Contract.from_layout(SKINS[name]())


class Strokes:
    """Touches that come, slide and go near the patches of the first nodes of a bus, with pauses."""

    has_noise = False

    def __init__(self, contract: Contract, seed: int = 0, nodes: int = 3) -> None:
        self._taxels = contract.layout.taxels
        self._random = np.random.default_rng(seed)
        shape = self._taxels.rows, self._taxels.columns
        self._rows, self._columns = np.indices(shape)
        count, cells = 30, contract.phi.taxels_of_blocks[[node.block for node in contract.on_bus(0)[:nodes]]]
        self._from = self._random.integers(0, STROKES_STEPS - 30, count)
        self._long = self._random.integers(2, 60, count)
        there = cells[cells < self._taxels.count]
        at = np.stack(np.unravel_index(self._random.choice(there, count), shape), axis=1)
        self._at = at + self._random.normal(0, 2, (count, 2))
        self._speed = self._random.normal(0, 0.3, (count, 2))
        self._width = self._random.uniform(1, 8, count)
        self._force_n = self._random.uniform(0.0005, 0.04, count)

    def frame(self, step: int) -> Frame:
        force_n = np.zeros(self._rows.shape)
        step %= STROKES_STEPS
        for each in range(len(self._from)):
            since = step - self._from[each]
            if 0 <= since < self._long[each]:
                row, column = self._at[each] + self._speed[each] * since
                away = np.square(self._rows - row) + np.square(self._columns - column)
                force_n += self._force_n[each] * np.exp(-away / self._width[each] ** 2)
        return Frame(np.minimum(force_n, 2 * self._taxels.force_max_n).astype(np.float32), "")


class SteppedTwins(Twins):
    """Nodes 1 to `nodes` of a bus in Python and in C that get strokes, and the fates of their frames.

    Parameters
    ----------
    sent, given_up : float
        Chances of a frame to be sent, and to be given up, before the next sample; else the controller keeps it.
    keeps : float
        Chance of a kept frame to stay for another sample.
    """

    def __init__(
        self, contract: Contract, *, sent: float = 0.8, given_up: float = 0.05, keeps: float = 0.95, **analogue: Any
    ) -> None:
        super().__init__(contract, nodes=3, source=Strokes(contract), **analogue)
        self.chances, self.keeps = (sent, given_up), keeps
        self.fates = np.random.default_rng(1)
        self.held = frames(0)
        self.answers()

    def step(self) -> int:
        """Go on by a millisecond; return how many frames were sent then."""
        self.go_on(1e-3, 1e-3)
        sent = self.answers()
        drawn, stays = self.fates.random(len(sent)), self.fates.random(len(self.held)) < self.keeps
        own, gone = sent[drawn < sum(self.chances)].copy(), self.held[~stays]
        own["flags"] |= np.where(drawn[drawn < sum(self.chances)] < self.chances[0], ECHO, DISCARDED).astype(np.uint8)
        self.held = np.concatenate([self.held[stays], sent[drawn >= sum(self.chances)]])
        gone["flags"] |= ECHO
        if len(own) + len(gone):
            self.put_all(np.concatenate([gone, own]))
            assert not len(self.answers())
        return len(sent)

    def run(self, milliseconds: int) -> int:
        """Go on; return how many frames were sent."""
        return sum(self.step() for _ in range(milliseconds))
