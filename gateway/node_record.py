"""The gateway's record of one node."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from canskin.messages import SILENT
from dbc.canopen import NmtState
from dbc.configuration import Setting
from dbc.contract import NodeContract
from gateway.foreign_sdo import ForeignClient
from gateway.sdo import SdoDialogue

#: An emergency at most this long before a node left is logged as the reason.
EXPLAINS_S: Final = 2.0


@dataclass
class NodeRecord:
    """State of one node; times are monotonic seconds.

    Attributes
    ----------
    signature : int
        The configuration signature (2006h) that the contract asks for.
    foreign : ForeignClient
        The SDO requests of other masters to the node.
    nmt : int
        NMT state in the newest heartbeat, `SILENT` when the heartbeat is overdue.
    trusted : bool
        The node's sums are used.
    started_ns : int or None
        When the newest NMT start of the gateway was on the bus; None while the start waits in the controller.
    proven_s : float
        When the newest successful proof read its oldest value.
    prove_at_s : float
        When the next dialogue of a node that is not in use begins.
    tries : int
        Dialogues since the node was last stable in OPERATIONAL.
    asked : bool
        The first dialogue has ended.
    heard_s, emcy_s, trusted_s, began_s : float
        Times of the newest heartbeat, the newest active emergency, the newest start of use, and the beginning of the
        newest proof.
    refusal : str
        Why the node's sums must not be used; empty if they may.
    dialogue : SdoDialogue or None
        The open proof.
    errand : SdoDialogue or None
        The open dialogue of a node in use about something else: `NmtMaster.ask`.
    hint : str
        The reason that the log gives for the next boot.
    lost_s : float or None
        When the node's sums were given up; None while they are used, or before their first use.
    """

    contract: NodeContract
    settings: Sequence[Setting]
    signature: int
    foreign: ForeignClient
    nmt: int = SILENT
    heard_s: float = -np.inf
    emcy: int = 0
    emcy_s: float = -np.inf
    trusted: bool = False
    trusted_s: float = -np.inf
    started_ns: int | None = 0
    proven_s: float = -np.inf
    refusal: str = ""
    dialogue: SdoDialogue | None = None
    errand: SdoDialogue | None = None
    began_s: float = -np.inf
    prove_at_s: float = 0.0
    #: Transfers of the last proof.
    cost: int = 1
    tries: int = 0
    asked: bool = False
    lost_s: float | None = None
    hint: str = ""

    @property
    def is_free(self) -> bool:
        """Whether no dialogue with the node is open: it answers one request at a time."""
        return self.dialogue is None and self.errand is None

    def explanation(self, now_s: float) -> str:
        """Return the emergency that explains why the node leaves now, empty without one."""
        return f" after EMCY {self.emcy:04X}h" if now_s - self.emcy_s < EXPLAINS_S else ""

    def end_errand(self) -> None:
        """Drop the errand if it is done."""
        if self.errand is not None and self.errand.done:
            self.errand = None


def state_text(state: int) -> str:
    """Return an NMT state in words."""
    try:
        return NmtState(state).name.lower().replace("_", "-")
    except ValueError:
        return f"state {state}"
