"""One adaptive CANopen node: its dictionary shows what the board has learned and would send."""

from collections.abc import Sequence
from functools import partial

from dbc import indices as od
from dbc.adaptive import KINDS, tpdo_index
from dbc.canopen import BASE_ID_MASK, COB_ID_INVALID, NmtState
from dbc.configuration import Setting
from dbc.contract import NodeContract
from dbc.objects import Object
from nodes.adaptive.boards import AdaptiveBoards
from nodes.adaptive.controllers import NO_COB_ID
from nodes.node import SkinNode
from nodes.objects import Outbox
from nodes.storage import Storage

#: Unit of the inhibit time in a sample.
_PER_SAMPLE = 10


class AdaptiveNode(SkinNode):
    """A virtual adaptive node of one block; parameters as for `SkinNode`."""

    def __init__(
        self,
        contract: NodeContract,
        objects: list[Object],
        settings: Sequence[Setting],
        calibration: Sequence[Setting],
        *,
        outbox: Outbox,
        hardware: AdaptiveBoards,
        storage: Storage,
        serial_number: int,
    ) -> None:
        self._boards = hardware
        self._pdo_ids: list[int] = []
        super().__init__(
            contract,
            objects,
            settings,
            calibration,
            outbox=outbox,
            hardware=hardware,
            storage=storage,
            serial_number=serial_number,
        )
        self._live |= {
            index: partial(hardware.read, contract.block, index)
            for index in (od.REFRESH, od.COEFFICIENT_NOISE, od.TAXEL_NOISE, od.NODE_NOISE, od.COARSE, od.FINE)
        }

    def boot(self, now_s: float, *, communication_only: bool = False) -> None:
        """Initialise, and forget what was sent."""
        super().boot(now_s, communication_only=communication_only)
        self._boards.forget(self.contract.block)

    def end(self) -> None:
        """Be silent, without TPDOs."""
        super().end()
        self._pdo_ids = [NO_COB_ID] * len(self._pdo_ids)
        if self._pdo_ids:
            self._boards.set_tpdos(self.contract.block, self._pdo_ids, [0] * len(self._pdo_ids))

    def _enter(self, state: NmtState) -> None:
        super()._enter(state)
        self._boards.set_operational(self.contract.block, state is NmtState.OPERATIONAL)

    def refresh(self, now_s: float) -> bool:
        """Read the objects again, with identifiers and inhibit times of the TPDOs."""
        is_changed = super().refresh(now_s)
        if is_changed:
            self._pdo_ids, inhibits = self._communication()
            self._boards.set_tpdos(self.contract.block, self._pdo_ids, inhibits)
        return is_changed

    @property
    def pdo_ids(self) -> list[int]:
        """The identifiers of the PDOs that exist."""
        return [cob_id for cob_id in self._pdo_ids if cob_id != NO_COB_ID]

    def refused(self, cob_id: int) -> None:
        """Take note of a PDO that found no room in the transmit queue."""
        self._boards.refuse(self.contract.block, self._pdo_ids.index(cob_id))

    def expired(self, count: int) -> None:
        """Do nothing: `AdaptiveBoards.take_echoes` has taken note."""

    def _communication(self) -> tuple[list[int], list[int]]:
        """Return identifier and inhibit time, in samples, of each TPDO, by `dbc.adaptive.tpdo_index`.

        One that does not exist has `NO_COB_ID`.
        """
        groups = self.contract.adaptive_tpdos[0].of_node
        cob_ids, inhibits = [NO_COB_ID] * (KINDS * groups), [0] * (KINDS * groups)
        for tpdo in self.contract.adaptive_tpdos:
            index = od.TPDO_COMMUNICATION + tpdo.number - 1
            cob_id, inhibit_100us = self.local.unsigned(index, 1), self.local.unsigned(index, 3)
            place = tpdo_index(tpdo.level, tpdo.group, tpdo.is_fine, groups)
            cob_ids[place] = NO_COB_ID if cob_id & COB_ID_INVALID else cob_id & BASE_ID_MASK
            inhibits[place] = -(-inhibit_100us // _PER_SAMPLE)
        return cob_ids, inhibits

    def _read_health(self, subindex: int) -> int | None:
        self.health[1:3] = self._boards.frames_of(self.contract.block)
        return super()._read_health(subindex)
