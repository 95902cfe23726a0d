"""Boards whose values stand still while their frames go on: a converter or a program of theirs has stopped.

Sums of one sample carry its noise: `calibration.defects` finds those that stand still. Averages and steps may stand
still for good reason: nothing touches the board. So the gateway asks such boards in turn for the newest counts of some
taxels (2012h), which carry the noise, and compares them with those of the look before:

* counts that have changed by more than `LEAST_COUNTS`, and by more than twice the change of any sum, are noise: a force
  that moves a taxel moves all sums;
* a look with all counts and all sums of the look before is a rest.

A board is frozen at `RESTS` rests in a row, if `NOISY` looks in a row have shown noise before. `TELLING` of its counts
or more have to be at neither end of the range, where there is no noise. Noise that changes counts by more than
`LEAST_COUNTS` has a deviation of 3 counts or so, and a count repeats itself with a probability below 0.14: so a board
is called frozen by chance with one below 0.14 ** (2 * 5) = 3e-9 for each beginning, and for the default sensor, 50
counts, below 1e-20. A sensor that only rounds shows no noise, and is never called frozen. Nor is a board that stood
still from the start of the gateway on, one without 2012h, or one whose asked taxels all stay at an end of the range.
"""

from collections.abc import Callable, Generator, Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from calibration.windows import Bools
from canskin.messages import Fault, Measurement, NodeFault
from dbc import indices as od
from dbc.contract import Contract
from gateway.nmt_master import NmtMaster
from gateway.sdo import Read, SdoAbortedError, Transfer

#: Time between two looks at a board, and after a look that showed nothing new. Each read takes time of the cycle from
#: the sums: on the default skin, looks every 20 s made seven times as many cycles incomplete.
PERIOD_S: Final = 300.0
AGAIN_S: Final = 1.0
#: Taxels of a board that are asked for.
PLACES: Final = 8
#: Most change of a count that may be rounding.
LEAST_COUNTS: Final = 4
#: Taxels that have to tell something in a look, looks in a row that prove the noise, and rests in a row without it.
TELLING: Final = 2
NOISY: Final = 8
RESTS: Final = 5

FROZEN: Final = NodeFault(Fault.FROZEN, "values stand still while frames go on")
_Counts = npt.NDArray[np.int64]


class FrozenBoards:
    """Finds them.

    Parameters
    ----------
    say : callable
        Called with a line for each board that is frozen, and for each that no longer is.

    Attributes
    ----------
    blocks : array of bool, shape (blocks,)
        Those of frozen boards.
    """

    def __init__(self, contract: Contract, say: Callable[[str], None]) -> None:
        layout, nodes = contract.layout, len(contract.nodes)
        self.blocks = np.zeros(contract.phi.blocks, np.bool_)
        self._contract, self._say = contract, say
        self._is_asking = not layout.taxels.is_analogue and (contract.in_steps or layout.samples_per_sync > 1)
        self._frozen = np.zeros(nodes, np.bool_)
        #: Of each board: when it is asked next, for which first place, looks with noise in a row, and rests in a row.
        self._due_s = np.full(nodes, np.nan)
        self._first, self._noisy, self._rests = np.zeros((3, nodes), np.intp)
        #: Counts and sums of the look before.
        self._before: list[tuple[_Counts, _Counts] | None] = [None] * nodes

    def on_bus(self, bus: int) -> dict[int, NodeFault]:
        """Return the faults of the frozen boards of a bus by node-ID."""
        frozen = [self._contract.nodes[each] for each in np.flatnonzero(self._frozen).tolist()]
        return {node.node_id: FROZEN for node in frozen if node.bus == bus}

    def tick(self, masters: Mapping[int, NmtMaster], newest: Measurement, stands_still: Bools, now_s: float) -> bool:
        """Look at the boards; return whether others are frozen now. Call it some times a second.

        Parameters
        ----------
        newest : Measurement
            As it came.
        stands_still : array of bool, shape (blocks,)
            Blocks whose sums show it.
        """
        if self._is_asking:
            self._ask(masters, newest, now_s)
        frozen = (self._rests >= RESTS) & (self._noisy >= NOISY)
        for place, node in enumerate(self._contract.nodes if stands_still.any() else ()):
            frozen[place] |= stands_still[node.block : node.block + node.blocks].all()
        changed = np.flatnonzero(frozen != self._frozen).tolist()
        self._frozen = frozen
        for place in changed:
            node = self._contract.nodes[place]
            self.blocks[node.block : node.block + node.blocks] = frozen[place]
            now = f"frozen: {FROZEN.words} [{FROZEN.code}]" if frozen[place] else "not frozen any more"
            self._say(f"{self._contract.layout.bus[node.bus].name} node {node.node_id} is {now}")
        return bool(changed)

    def _ask(self, masters: Mapping[int, NmtMaster], newest: Measurement, now_s: float) -> None:
        """Ask the board that is due."""
        if np.isnan(self._due_s[0]):
            self._due_s = now_s + np.linspace(0, PERIOD_S, len(self._due_s), endpoint=False)
        place = int(self._due_s.argmin())
        if now_s < self._due_s[place]:
            return
        node, phi = self._contract.nodes[place], self._contract.phi
        blocks = slice(node.block, node.block + node.blocks)
        self._due_s[place] = now_s + PERIOD_S
        if not np.frombuffer(newest.valid, np.uint8)[blocks].all():
            self._before[place] = None
            return
        sums = np.frombuffer(newest.sums, "<i4")[phi.starts[blocks.start] : phi.starts[blocks.stop]].astype(np.int64)
        master = masters.get(node.bus)
        if master is None or master.ask(node.node_id, self._read(place, sums, now_s), now_s) is None:
            self._due_s[place] = now_s + AGAIN_S

    def _read(self, place: int, sums: _Counts, now_s: float) -> Generator[Transfer, bytes, None]:
        size = self._contract.phi.block_size
        places = (self._first[place] + np.linspace(0, size, min(PLACES, size), endpoint=False).astype(int)) % size
        counts: list[int] = []
        try:
            for each in places.tolist():
                data = yield Read(od.COUNTS, each + 1, od.UNSIGNED16)
                counts += [int.from_bytes(data, "little")]
        except SdoAbortedError:
            return
        self._look(place, np.array(counts), sums)
        if self._rests[place] and self._noisy[place] >= NOISY:
            self._due_s[place] = now_s + AGAIN_S

    def _look(self, place: int, counts: _Counts, sums: _Counts) -> None:
        """Compare what a board tells with what it told before."""
        before, self._before[place] = self._before[place], (counts, sums)
        is_end = np.isin(counts, (0, self._contract.layout.taxels.count_max))
        if (~is_end).sum() < TELLING:
            self._before[place] = None
            self._first[place] += 1
            return
        if before is None:
            return
        change, moved = np.abs(counts - before[0]), int(np.abs(sums - before[1]).max(initial=0))
        if not change.any() and not moved:
            self._rests[place] += 1
        else:
            if 1 < self._rests[place] < RESTS:  # by chance with 0.14 ** 4: there may be no noise
                self._noisy[place] = 0
            self._rests[place] = 0
        if self._noisy[place] < NOISY:
            is_noisy = (change > max(LEAST_COUNTS, 2 * moved)).sum() >= TELLING
            self._noisy[place] = self._noisy[place] + 1 if is_noisy else 0
