"""One adaptive CANopen node: its dictionary shows what the board has learned and would send."""

from collections.abc import Sequence
from functools import partial

from dbc.adaptive import TPDOS, tpdo_index
from dbc.canopen import BASE_ID_MASK, COB_ID_INVALID
from dbc.configuration import Setting
from dbc.contract import NodeContract
from dbc.indices import (
    OD_COARSE,
    OD_COEFFICIENT_NOISE,
    OD_FINE,
    OD_NODE_NOISE,
    OD_REFRESH,
    OD_TAXEL_NOISE,
    OD_TPDO_COMMUNICATION,
)
from dbc.objects import Object
from nodes.adaptive.boards import AdaptiveBoards
from nodes.adaptive.controllers import NO_COB_ID
from nodes.network import SegmentNetwork
from nodes.node import SkinNode
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
        *,
        network: SegmentNetwork,
        boards: AdaptiveBoards,
        storage: Storage,
    ) -> None:
        super().__init__(contract, objects, settings, network=network, boards=boards, storage=storage)
        self._adaptive = boards
        self._live |= {
            index: partial(boards.read, contract.block, index)
            for index in (OD_REFRESH, OD_COEFFICIENT_NOISE, OD_TAXEL_NOISE, OD_NODE_NOISE, OD_COARSE, OD_FINE)
        }

    def boot(self, now_s: float, *, communication_only: bool = False) -> None:
        """Initialise, and forget what was sent."""
        super().boot(now_s, communication_only=communication_only)
        self._adaptive.forget(self.contract.block)

    def communication(self) -> tuple[list[int], list[int]]:
        """Return identifier and inhibit time, in samples, of each TPDO, by `dbc.adaptive.tpdo_index`.

        One that does not exist has `NO_COB_ID`.
        """
        cob_ids, inhibits = [NO_COB_ID] * TPDOS, [0] * TPDOS
        for tpdo in self.contract.adaptive_tpdos:
            index = OD_TPDO_COMMUNICATION + tpdo.number - 1
            cob_id, inhibit_100us = self._unsigned(index, 1), self._unsigned(index, 3)
            place = tpdo_index(tpdo.level, tpdo.group, tpdo.is_fine)
            cob_ids[place] = NO_COB_ID if cob_id & COB_ID_INVALID else cob_id & BASE_ID_MASK
            inhibits[place] = -(-inhibit_100us // _PER_SAMPLE)
        return cob_ids, inhibits

    def _unsigned(self, index: int, subindex: int) -> int:
        """Return a stored value; this is faster than the library, which matters for 32 TPDOs of every node."""
        data = self.local.data_store.get(index, {}).get(subindex)
        if data is not None:
            return int.from_bytes(data, "little")
        found = self.local.variable(index, subindex)
        return int(found.default or 0) if found else 0

    def _read_health(self, subindex: int) -> int | None:
        self.health[1:3] = self._adaptive.frames_of(self.contract.block)
        return super()._read_health(subindex)
