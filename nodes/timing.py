"""When the boards of one bus sample and send, as their segment sees it."""

from abc import ABC, abstractmethod
from typing import ClassVar, Final

import numpy as np
import numpy.typing as npt

from dbc.canopen import BASE_ID_MASK
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, Frames
from nodes.sampler import Sampler

#: The next SYNC is expected within these times after the last SYNC, in periods.
QUIET_FROM: Final = 0.7
QUIET_TO: Final = 2.0


class Timing(ABC):
    """When boards sample and send, and when a TPDO counts as sent."""

    #: Whether a TPDO counts as sent as soon as the transmit queue has accepted it.
    counts_accepted: ClassVar[bool]

    @abstractmethod
    def begin(self, now_s: float, since_sync_s: float) -> bool:
        """Sample what is due by time; tell whether this is a time for heartbeats."""

    def news(self, now_s: float) -> Frames | None:  # noqa: ARG002  not all boards send by themselves
        """Return the sums that boards send by themselves."""
        return None

    @abstractmethod
    def measure(self, counter: int, time_ns: int) -> npt.NDArray[np.int32] | None:
        """Return what the boards measure at a SYNC; its counter is 0 without one."""

    @abstractmethod
    def count(self, arrived: Frames, is_pdo: npt.NDArray[np.bool_]) -> tuple[int, int, int]:
        """Count the boards' own TPDOs among received frames.

        Returns
        -------
        sent, dropped : int
            By how much the numbers of TPDOs sent and dropped change.
        others : int
            Frames that the boards still have to take.
        """


class AtSync(Timing):
    """All sums at every SYNC, as one burst."""

    counts_accepted = True

    def __init__(self, contract: Contract, bus: int, sampler: Sampler) -> None:
        self._bus, self._sampler = bus, sampler
        self._period_s = contract.layout.sync.period_s

    def begin(self, now_s: float, since_sync_s: float) -> bool:  # noqa: ARG002  a SYNC tells when to sample
        """Tell whether no SYNC is expected.

        A heartbeat sent while a SYNC waits to be read would delay the burst that answers this SYNC.
        """
        return not QUIET_FROM * self._period_s < since_sync_s < QUIET_TO * self._period_s

    def measure(self, counter: int, time_ns: int) -> npt.NDArray[np.int32]:
        """Sample all taxels."""
        return self._sampler.sample(counter, time_ns, self._bus)

    def count(self, arrived: Frames, is_pdo: npt.NDArray[np.bool_]) -> tuple[int, int, int]:
        """Count the TPDOs that could not be sent within the window (1007h); nobody needs the others' echoes."""
        flags = arrived["flags"]
        own = flags[(flags & ECHO != 0) & is_pdo[arrived["can_id"] & BASE_ID_MASK]]
        dropped = int(np.count_nonzero(own & ERROR))
        return -dropped, dropped, len(arrived) - (len(own) - dropped)
