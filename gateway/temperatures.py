"""The temperatures of the boards (2036h), which the gateway reads in turn while they run."""

from collections.abc import Callable, Generator, Mapping
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc import indices as od
from dbc.contract import Contract, NodeContract
from dbc.dictionary import TEMPERATURE_UNKNOWN
from gateway.nmt_master import NmtMaster
from gateway.sdo import Read, SdoAbortedError, Transfer

#: Time between two reads of a node's temperature.
PERIOD_S: Final = 5.0
#: Unit of 2036h, kelvin.
STEP_K: Final = 0.1


class Temperatures:
    """Reads the temperatures of all nodes of a skin, evenly over `PERIOD_S`.

    Parameters
    ----------
    contract : Contract
        With thermometers.
    take : callable
        Called each `PERIOD_S` with the newest temperatures, kelvin, shape (blocks,): NaN where a node is not in use, or
        knows none.
    """

    def __init__(self, contract: Contract, take: Callable[[npt.NDArray[np.float64]], None]) -> None:
        self._nodes = contract.nodes
        self._take = take
        self._kelvin = np.full(contract.phi.blocks, np.nan)
        self._turn, self._next_s = 0, -np.inf

    def tick(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Ask the node whose turn it is, unless its SDO channel is busy; call it many times a second."""
        if now_s < self._next_s:
            return
        self._next_s = now_s + PERIOD_S / len(self._nodes)
        node = self._nodes[self._turn]
        self._turn = (self._turn + 1) % len(self._nodes)
        if self._turn == 0:
            self._take(self._kelvin.copy())
        master = masters.get(node.bus)
        if master is None or not master.nodes[node.node_id].in_use:
            self._note(node, np.nan)
        else:
            master.ask(node.node_id, self._read(node), now_s)

    def _read(self, node: NodeContract) -> Generator[Transfer, bytes, None]:
        try:
            data = yield Read(od.TEMPERATURE, 0, od.INTEGER16)
            steps = int.from_bytes(data, "little", signed=True)
        except SdoAbortedError:
            steps = TEMPERATURE_UNKNOWN
        self._note(node, STEP_K * steps if 0 < steps < TEMPERATURE_UNKNOWN else np.nan)

    def _note(self, node: NodeContract, kelvin: float) -> None:
        self._kelvin[node.block : node.block + node.blocks] = kelvin
