"""Stepped boards that run the C firmware (`firmware`) in place of `nodes.steps.boards`."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dbc.canopen import BASE_ID_MASK
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, Frames
from dbc.patch_filter import Floats
from nodes.firmware.library import Firmware
from nodes.steps.patch_boards import PatchBoards
from skin.sources import TaxelSource


class FirmwarePatches(PatchBoards):
    """All boards of a process: they get the samples of their patches. Gains, offsets and patterns are theirs alone.

    Parameters
    ----------
    firmware : Firmware
        Compiled for these boards.
    **analogue
        Those of `PatchBoards`.
    """

    def __init__(
        self, contract: Contract, blocks: Sequence[int], source: TaxelSource, firmware: Firmware, **analogue: Any
    ) -> None:
        super().__init__(contract, blocks, source, **analogue)
        self._boards = {bus: firmware.boards(bus) for bus in self._rows}
        # The boards learn the noise of the untouched skin, as when they are switched on.
        while not self._pass_counts():
            pass

    def _pass_counts(self) -> bool:
        self._sensors.sample(0)
        return self._take_counts()

    def _take_counts(self) -> bool:
        ready = [boards.take_counts(self._sensors.counts[self._rows[bus]]) for bus, boards in self._boards.items()]
        return all(ready)

    def _take(self, sample_n: Floats) -> None:  # noqa: ARG002  boards sample in counts
        self._take_counts()

    def _decide(self, now_ns: int) -> None:
        """Do nothing: boards decide when they are asked for frames."""

    def news(self, bus: int, now_s: float) -> Frames:
        """Return the frames of a bus of the slots that have begun."""
        return self._boards[bus].choose(round(now_s * 1e9))

    def count(
        self,
        bus: int,  # noqa: ARG002  `is_pdo` is that of the bus
        arrived: Frames,
        is_pdo: npt.NDArray[np.bool_],
    ) -> tuple[int, int, int]:
        """Count the boards' own TPDOs that were sent; the boards themselves take them with the other frames."""
        own = arrived["can_id"][arrived["flags"] & (ECHO | ERROR) == ECHO]
        return int(np.count_nonzero(is_pdo[own & BASE_ID_MASK])), 0, len(arrived)

    @property
    def is_sending(self) -> bool:
        """Whether a controller may hold a frame, or its echo is to be read."""
        return any(boards.is_sending for boards in self._boards.values())
