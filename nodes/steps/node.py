"""One stepped CANopen node: its dictionary shows what the board has learned and would send."""

from functools import partial

from dbc import indices as od
from dbc.canopen import BASE_ID_MASK, COB_ID_INVALID, NmtState
from dbc.contract import NodeContract
from nodes.node import SkinNode
from nodes.node_objects import NodeObjects
from nodes.objects import Outbox
from nodes.steps.boards import SteppedBoards
from nodes.steps.stepping import NO_COB_ID


class SteppedNode(SkinNode):
    """A virtual stepped node of one block; parameters as for `SkinNode`."""

    def __init__(self, contract: NodeContract, objects: NodeObjects, outbox: Outbox, hardware: SteppedBoards) -> None:
        super().__init__(contract, objects, outbox, hardware)
        self._senders = hardware.senders
        self.objects.readers |= {
            index: partial(hardware.read, contract.block, index)
            for index in (od.SYNC_COUNTER, od.REFRESH, od.COEFFICIENT_NOISE, od.TAXEL_NOISE, od.NODE_NOISE, od.WORDS)
        }

    def boot(self, now_s: float, *, communication_only: bool = False) -> None:
        """Initialise, and forget what was sent."""
        super().boot(now_s, communication_only=communication_only)
        self._senders.forget(self.contract.block)

    def end(self) -> None:
        """Be silent, without TPDOs."""
        super().end()
        self.tpdos = []
        self._senders.set_cob_ids(self.contract.block, [NO_COB_ID] * len(self.contract.tpdos))

    def _enter(self, state: NmtState) -> None:
        super()._enter(state)
        self._senders.set_operational(self.contract.block, state is NmtState.OPERATIONAL)

    def refresh(self, now_s: float) -> bool:
        """Read the objects again, with the identifiers of the TPDOs, which are sent by themselves."""
        is_changed = super().refresh(now_s)
        if is_changed:
            records = [od.TPDO_COMMUNICATION + tpdo.number - 1 for tpdo in self.contract.tpdos]
            cob_ids = [self.local.unsigned(record, 1) for record in records]
            used = [NO_COB_ID if each & COB_ID_INVALID else each & BASE_ID_MASK for each in cob_ids]
            self._senders.set_cob_ids(self.contract.block, used)
            self._has_events = False
        return is_changed

    def refused(self, cob_id: int) -> None:
        """Take note of a PDO that found no room in the transmit queue."""
        self._senders.refuse(self.contract.bus, cob_id)

    def expired(self, count: int) -> None:
        """Do nothing: `SteppedBoards.count` has taken note."""

    def _read_health(self, subindex: int) -> int | None:
        self.health[1:3] = self._senders.counts[self.contract.block].tolist()
        return super()._read_health(subindex)
