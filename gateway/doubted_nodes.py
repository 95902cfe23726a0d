"""Nodes whose gains or offsets have become others without the gateway, until somebody accepts them."""

from collections.abc import Iterable, Mapping

import numpy as np

from calibration.windows import Bools
from canskin.calibration_messages import Region
from dbc.contract import Contract, NodeContract
from gateway.nmt_master import NmtMaster
from skin.regions import taxels_of


class DoubtedNodes:
    """Finds them.

    Attributes
    ----------
    names : list of str
        Of the nodes that nobody has accepted.
    """

    def __init__(self, contract: Contract) -> None:
        self._contract = contract
        self.names: list[str] = []

    def changed(self, masters: Mapping[int, NmtMaster]) -> Bools:
        """Return the blocks, shape (blocks,), whose nodes have begun to correct otherwise since the last call."""
        blocks = self._blocks_of(node for master in masters.values() for node in master.recalibrated)
        for master in masters.values():
            master.recalibrated.clear()
        return blocks

    def accept(self, masters: Mapping[int, NmtMaster], region: Region | str | None = None) -> None:
        """Accept the gains and offsets of all nodes, or of those whose taxels are all in a region."""
        others = np.zeros(self._contract.phi.blocks, np.bool_)
        if region is not None:
            others[self._contract.phi.blocks_of(~taxels_of(self._contract.layout, region))] = True
        for node in (each for master in masters.values() for each in master.nodes.values()):
            if not (others & self._blocks_of([node.contract])).any():
                node.known.accept()

    def find(self, masters: Mapping[int, NmtMaster]) -> Bools:
        """Return the blocks, shape (blocks,), of nodes that nobody has accepted."""
        every = (each for master in masters.values() for each in master.nodes.values())
        nodes = [each.contract for each in every if each.known.is_doubtful]
        self.names = [f"{self._contract.layout.bus[each.bus].name} node {each.node_id}" for each in nodes]
        return self._blocks_of(nodes)

    def _blocks_of(self, nodes: Iterable[NodeContract]) -> Bools:
        blocks = np.zeros(self._contract.phi.blocks, np.bool_)
        for each in nodes:
            blocks[each.block : each.block + each.blocks] = True
        return blocks
