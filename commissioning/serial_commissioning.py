"""Commissioning of boards whose serial numbers tell their places."""

from collections.abc import Generator

from commissioning.board_steps import OTHER_HINT, Board, Commissioning
from commissioning.lss_steps import TWO_SERIALS, Address, Answer, Step, Steps, TroubleError
from dbc.canopen import NO_NODE_ID, Lss
from dbc.dictionary import REVISION


class SerialCommissioning(Commissioning):
    """Commissions the boards of one bus by their serial numbers."""

    def _work(self) -> Steps:
        if not (yield from self._is_alone()):
            return
        for node_id, (talked, address) in (yield from self._numbered()).items():
            yield from self._guarded(self.boards[node_id], self._with_number(self.boards[node_id], talked, address))
        for board in self.boards.values():
            if not board.is_begun:
                yield from self._guarded(board, self._fresh(board))
        yield from self._others()

    def _fresh(self, board: Board) -> Steps:
        """Look for a board by its address, and commission it."""
        device = self._contract.layout.device
        address = device.vendor_id, device.product_code, REVISION, board.serial
        if (yield from self._select(address)):
            old = (yield from self._configure(Lss.INQUIRE_NODE_ID))[1]
            if old not in (board.node.node_id, NO_NODE_ID):
                board.done = f"has node-ID {old}"
                if not self._renumber:
                    raise TroubleError(f"has another node-ID{OTHER_HINT}")
                yield from self._take_node_id(old)
                yield from self._selected(board, address)
            else:
                yield from self._give(board)

    def _others(self) -> Steps:
        """Find the boards without node-ID that are left: of another revision, or strangers."""
        found = yield from self._unnumbered()
        device = self._contract.layout.device
        for address, count in found.items():
            vendor, product, revision, serial = address
            owner = self._serials.get(serial)
            board = self.boards.get(owner.node_id) if owner else None
            name = f"a board without node-ID, vendor-ID {vendor:X}h, product code {product:X}h, serial number {serial}"
            if (vendor, product) != (device.vendor_id, device.product_code) or owner is None:
                self.strangers.append(f"{name}: not a board of this skin")
            elif board is None or board.node != owner:
                self.strangers.append(f"{name}: its place is {self._place(owner)}, on another bus")
            elif board.is_begun:
                if not board.trouble and not (yield from self._is_numbered(board, address)):
                    self.strangers.append(f"{name}: {self._place(owner)} has this serial number already")
            elif count > 1:
                board.trouble = TWO_SERIALS
            else:
                board.done = f"found, revision {revision:X}h"
                yield from self._guarded(board, self._selected(board, address))

    def _is_numbered(self, board: Board, address: Address) -> Generator[Step, Answer, bool]:
        """Tell whether one board has the address, with its node-ID: Lely answers the fastscan then, too."""
        found = NO_NODE_ID
        try:
            if (yield from self._select(address)):
                found = (yield from self._configure(Lss.INQUIRE_NODE_ID))[1]
        except TroubleError:  # two boards answer
            pass
        yield from self._all_waiting()
        return found == board.node.node_id

    def _selected(self, board: Board, address: Address) -> Steps:
        if not (yield from self._select(address)):
            raise TroubleError("no longer answers")
        yield from self._give(board)
