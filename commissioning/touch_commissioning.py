"""Commissioning of boards whose places nobody knows: a touch on a board tells where it sits.

All boards without node-ID get one of the node-IDs that are free, for a while. PRE-OPERATIONAL, they tell counts of
their taxels, and the user touches one place after the other. The board that is touched stores the node-ID of the place
by LSS, and takes it with the next reset: until all places are done, no board has to be found anew, and a run that is
stopped loses nothing. While the finger stays, the board is in the state LSS configuration, in which its LED flickers.
It stores the node-ID when the finger has been lifted.
"""

from collections.abc import Callable, Generator, Sequence
from typing import Any, Final, cast

import numpy as np

from bus.link import Send
from canskin.errors import LayoutError
from commissioning.board_steps import Board, Commissioning
from commissioning.count_reading import SAMPLED_S
from commissioning.lss_steps import (
    RESET_S,
    SELECTED_S,
    TWO_SERIALS,
    Address,
    Answer,
    Ask,
    RefusedError,
    Step,
    Steps,
    Talk,
    Talked,
    TroubleError,
)
from commissioning.touch_sensing import TouchSensing, map_of
from dbc import indices as od
from dbc.canopen import (
    HEARTBEAT_BASE,
    LSS_REQUEST_COB_ID,
    NMT_COB_ID,
    NO_NODE_ID,
    SYNC_COB_ID,
    Lss,
    NmtCommand,
)
from dbc.contract import Contract, NodeContract, sync_frame
from dbc.dictionary import REVISION, sum_type
from dbc.lss import lss_request
from gateway.sdo import Dialogue, Read, SdoAbortedError, SdoError, Transfer
from skin.surface import Floats, Indices
from skin.sync_counter import next_counter

#: Rounds without touch at the begin.
REST_ROUNDS: Final = 10
#: Time to take the hands away before these rounds.
AWAY_S: Final = 2.0
#: Rounds in a row that tell the same touch, or none.
HELD_ROUNDS: Final = 3
#: Longest wait for a touch on a place: from map to skin.
PATIENCE_OF_TOUCH_S: Final = 60.0
#: Taxels around the middle of a board, and part of them that has to be its own.
NEAREST: Final = 5
LEAST_OWN: Final = 0.5
#: Counts or sums that are read of a board, about: every n-th, n odd, so that they are not those of one column.
READ_OF_BOARD: Final = 16


def require_patches(contract: Contract) -> None:
    """Check that a finger can touch the middle of each board alone; LayoutError where taxels of others are there."""
    phi, positions_m = contract.phi, contract.layout.taxels.surface.positions_m
    for node in contract.nodes:
        mine = _taxels(contract, node)
        away_m = np.linalg.norm(positions_m - positions_m[mine].mean(axis=0), axis=1)
        away_m[~phi.is_wired[: len(away_m)]] = np.inf
        near = np.argsort(away_m, kind="stable")[:NEAREST]
        if np.isin(near, mine).mean() < LEAST_OWN:
            line = contract.layout.bus[node.bus].name
            raise LayoutError(
                f"--touch: the taxels of {line}, node {node.node_id} do not lie together: expected boards that a finger"
                ' touches one by one (measurement.wiring = "board", or chains)'
            )


class TouchCommissioning(Commissioning):
    """Commissions the boards of one bus by touch.

    Parameters
    ----------
    say : callable
        Takes a line for the person who touches.
    patience_s : float
        Longest wait for a touch on a place, and for its end.
    **options
        The other parameters of `Commissioning`.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int,
        send: Send,
        now_s: float,
        *,
        say: Callable[[str], None],
        patience_s: float = PATIENCE_OF_TOUCH_S,
        **options: Any,
    ) -> None:
        self._say, self._patience_s = say, patience_s
        #: The boards with a node-ID for a while, by this node-ID; and those that have stored that of their place.
        self._lent: dict[int, Address] = {}
        self._placed: dict[int, Board] = {}
        self._counter = 0
        #: The skin was touched when nothing had to touch it.
        self._is_disturbed = False
        super().__init__(contract, bus, send, now_s, **options)
        # A serial number tells no place.
        self._serials = {}

    def give_up(self) -> None:
        """End at once; boards that were touched take their node-IDs, the others lose theirs."""
        super().give_up()
        for node_id in self._lent:
            self._reset(node_id)

    def _reset(self, node_id: int) -> None:
        self._send_one(NMT_COB_ID, bytes((NmtCommand.RESET_NODE, node_id)))

    def _work(self) -> Steps:
        if not (yield from self._is_alone()):
            return
        for node_id in (yield from self._numbered()):
            yield from self._has_stored(node_id)
        # A board that stored the node-ID of its place in a run that was killed has this node-ID from now on.
        numbered = yield from self._numbered()
        for node_id, (talked, address) in numbered.items():
            yield from self._guarded(self.boards[node_id], self._with_number(self.boards[node_id], talked, address))
        yield from self._lend_all({address for _, address in numbered.values()})
        if self._lent:
            yield from self._touches()
            yield from self._take_places()

    def _has_stored(self, node_id: int) -> Generator[Step, Answer, bool]:
        """Reset a board; tell whether it comes back: a run that was killed has left numbers that are not stored."""
        reset = bytes((NmtCommand.RESET_NODE, node_id))
        return bool((yield Ask(NMT_COB_ID, reset, b"\0", SELECTED_S, HEARTBEAT_BASE + node_id)))

    # Node-IDs for a while

    def _lend_all(self, numbered: set[Address]) -> Steps:
        """Find the boards without node-ID, and lend each a node-ID that is free."""
        device = self._contract.layout.device
        mine = device.vendor_id, device.product_code
        free = [board.node for board in self.boards.values() if not board.is_begun]
        # To select the serial numbers of the layout takes less time than a fastscan.
        likely = [(*mine, REVISION, board.serial) for board in self.boards.values()]
        yield from self._lend_some([each for each in likely if each not in numbered], free, is_sure=False)
        found = yield from self._unnumbered()
        for address in [each for each in found if each[:2] != mine]:
            self.strangers.append(f"{_name(address)}: not a board of this skin")
            del found[address]
        yield from self._lend_some([*found], free, is_sure=True)

    def _lend_some(self, found: Sequence[Address], free: list[NodeContract], *, is_sure: bool) -> Steps:
        for address in found:
            try:
                yield from self._lend(address, free, is_sure=is_sure)
            except TroubleError as trouble:
                text = f"{_name(address)}: {trouble}"
                if text not in self.strangers:
                    self.strangers.append(text)
            yield from self._all_waiting()

    def _lend(self, address: Address, free: list[NodeContract], *, is_sure: bool) -> Steps:
        if not (yield from self._select(address)):
            if is_sure:
                raise TroubleError("no longer answers")
            return
        old = (yield from self._configure(Lss.INQUIRE_NODE_ID))[1]
        if old != NO_NODE_ID:
            raise TroubleError(f"has node-ID {old}, which is none of the layout's")
        refused = TroubleError("the layout has no place left for it")
        for node in free:
            try:
                yield from self._configure(Lss.NODE_ID, node.node_id, what=f"node-ID {node.node_id}")
            except RefusedError as error:  # a board of another type
                refused = error
                continue
            self._lent[node.node_id] = address
            free.remove(node)
            waiting = lss_request(Lss.SWITCH_GLOBAL)
            booted = yield Ask(LSS_REQUEST_COB_ID, waiting, b"\0", SELECTED_S, HEARTBEAT_BASE + node.node_id)
            if len(booted) != 1:
                self._lent.pop(node.node_id)
                self._reset(node.node_id)
                raise TroubleError(TWO_SERIALS if booted else "sends no boot-up message")
            return
        raise refused

    # Touches

    def _touches(self) -> Steps:
        """Ask for a touch on each place without board."""
        self._say(f"{len(self._lent)} boards without node-ID: leave the skin alone")
        yield Ask(0, b"", wait_s=AWAY_S)
        rest: list[dict[int, Floats]] = []
        while len(rest) < REST_ROUNDS:
            rest += [(yield from self._round())]
        packing = self._contract.packing
        sensing = TouchSensing(rest, self._contract.layout.taxels.count_max, packing.rounding_counts)
        for board in self.boards.values():
            if self._is_disturbed or not self._lent.keys() - self._placed.keys():
                return
            if not board.is_begun:
                yield from self._guarded(board, self._touch(board, sensing))

    def _touch(self, board: Board, sensing: TouchSensing) -> Steps:
        """Wait for a touch on a place, and give the board there the node-ID of the place."""
        self._ask_for(board.node)
        until_s = self._now_s + self._patience_s
        while True:
            touched = yield from self._held(sensing, until_s, bool)
            if touched is None:
                raise TroubleError(f"no touch came in {self._patience_s:g} s: is its board on this bus? Run it again")
            owner = self._placed.get(touched[0]) or (None if touched[0] in self._lent else self.boards[touched[0]])
            if len(touched) > 1:
                self._say(f"{len(touched)} boards are touched at once: lift")
            elif owner is not None:
                self._say(f"this is {_blocks_text(owner.node)}, whose board has its node-ID already: lift")
            else:
                address = self._lent[touched[0]]
                if not (yield from self._select(address)):  # its LED flickers from now on
                    raise TroubleError("no longer answers")
                self._say(f"{_blocks_text(board.node)}: felt by the board with serial number {address[3]}: lift")
            # A hand that was there in the rounds without touch, and leaves, looks like a touch that does not end.
            if (yield from self._held(sensing, self._now_s + self._patience_s, lambda each: not each)) is None:
                self._is_disturbed = True
                raise TroubleError("a touch does not end: was the skin touched at the begin? Run it again")
            if owner is None and len(touched) == 1:
                yield from self._give_place(board, touched[0])
                return
            self._say(f"touch {_blocks_text(board.node)} alone")

    def _give_place(self, board: Board, lent: int) -> Steps:
        """Let the selected board with the node-ID `lent` store that of its place."""
        yield from self._configure(Lss.NODE_ID, board.node.node_id, what=f"node-ID {board.node.node_id}")
        yield from self._bit_timing()
        yield from self._store()
        board.serial, board.done = self._lent[lent][3], "has stored its node-ID"
        self._placed[lent] = board

    def _held(
        self, sensing: TouchSensing, until_s: float, is_wanted: Callable[[tuple[int, ...]], bool]
    ) -> Generator[Step, Answer, tuple[int, ...] | None]:
        """Return the boards that are touched, once some rounds in a row tell the same; None when the time is over."""
        last: tuple[int, ...] | None = None
        times = 0
        while self._now_s < until_s:
            touched = sensing.touched((yield from self._round()))
            times = times + 1 if touched == last else 1
            last = touched
            if times >= HELD_ROUNDS and is_wanted(touched):
                return touched
        return None

    def _round(self) -> Generator[Step, Answer, dict[int, Floats]]:
        """Let the boards sample, and return what each tells, counts; a board that is silent is named once."""
        self._counter = next_counter(self._counter)
        (sync,) = sync_frame(self._counter)
        data = sync["data"][: sync["length"]].tobytes()
        yield Ask(SYNC_COB_ID, data, wait_s=max(SAMPLED_S, self._contract.layout.sync.period_s))
        asked = {*self._lent} | {node_id for node_id, board in self.boards.items() if board.is_complete}
        came = yield Talk({each: _read_touch(self._contract, self.boards[each].node) for each in sorted(asked)})
        told: dict[int, Floats] = {}
        for node_id, talked in cast("dict[int, Talked]", came).items():
            if talked.dialogue.error is None:
                told[node_id] = np.array(talked.dialogue.result, np.float64)
            elif node_id in self._lent:
                address = self._lent.pop(node_id)
                if node_id not in self._placed:
                    self.strangers.append(f"{_name(address)}: {talked.dialogue.error}, before a touch on it")
            else:
                self.boards[node_id].is_complete = False
                self.boards[node_id].trouble = str(talked.dialogue.error)
        return told

    def _ask_for(self, node: NodeContract) -> None:
        """Show where the next touch is awaited."""
        positions_m, taxels = self._contract.layout.taxels.surface.positions_m, _taxels(self._contract, node)
        for line in map_of(positions_m, taxels):
            self._say(f"  {line}")
        middle_m = positions_m[taxels].mean(axis=0)
        where = ", ".join(f"{axis} {1e3 * at_m + 0:.0f} mm" for axis, at_m in zip("xyz", middle_m, strict=True))
        self._say(f"touch {_blocks_text(node)}, # on the map: {where}")

    # The end

    def _take_places(self) -> Steps:
        """Reset the boards: those that were touched boot with the node-IDs of their places, and are set up."""
        for lent, address in self._lent.items():
            self._reset(lent)
            if lent not in self._placed:
                self.strangers.append(f"{_name(address)}: was not touched, has no node-ID again")
        self._lent.clear()
        yield Ask(0, b"", wait_s=RESET_S)
        for board in self._placed.values():
            yield from self._guarded(board, self._boot(board))

    def _boot(self, board: Board) -> Steps:
        """Reset a board alone, for it shared its node-ID for a moment, and set it up."""
        if not (yield from self._has_stored(board.node.node_id)):
            raise TroubleError("sends no boot-up message")
        yield from self._set_up(board)


def _name(address: Address) -> str:
    return f"the board with serial number {address[3]} (vendor-ID {address[0]:X}h, product code {address[1]:X}h)"


def _blocks_text(node: NodeContract) -> str:
    return f"block {node.block}" if node.blocks == 1 else f"blocks {node.block} to {node.block + node.blocks - 1}"


def _taxels(contract: Contract, node: NodeContract) -> Indices:
    """Return the taxels of a node, without empty places."""
    taxels = contract.phi.taxels_of_blocks[node.block : node.block + node.blocks].ravel()
    return taxels[taxels < contract.layout.taxels.count]


def _read_touch(contract: Contract, node: NodeContract) -> Dialogue:
    """Read some counts of a node (2012h), of a board without counts some sums (2100h).

    A finger as wide as the board leaves most sums as they were, and changes those of its neighbours.
    """
    try:
        return (yield from _read_some(od.COUNTS, [contract.phi.block_size] * node.blocks, od.UNSIGNED16))
    except SdoAbortedError:
        starts = contract.phi.starts[node.block : node.block + node.blocks + 1]
        raw = yield from _read_some(od.SUMS, np.diff(starts).tolist(), sum_type(node.packing))
    return node.packing.counts(np.array(raw, np.int32))


def _read_some(index: int, counts: Sequence[int], data_type: int) -> Generator[Transfer, bytes, list[int]]:
    """Read some of the numbers of the blocks of a node: `counts` tells how many each block has."""
    there = [(place, k + 1) for place, count in enumerate(counts) for k in range(count)]
    if not there:
        raise SdoError("tells neither counts of taxels (2012h) nor sums (2100h)")
    numbers = []
    for place, subindex in there[:: len(there) // READ_OF_BOARD | 1]:
        value = yield Read(od.of_block(index, place), subindex, data_type)
        numbers.append(int.from_bytes(value, "little", signed=data_type in od.SIGNED))
    return numbers
