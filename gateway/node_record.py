"""What the gateway knows of one node."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dbc.configuration import Setting
from dbc.contract import NodeContract
from gateway.sdo import SdoDialogue
from skin.messages import SILENT


@dataclass
class NodeRecord:
    """State of one node; times are monotonic seconds.

    Attributes
    ----------
    compared : frozenset of int
        Indices of the objects that its proof compares.
    nmt : int
        NMT state by its newest heartbeat, `SILENT` when that is overdue.
    trusted : bool
        Its sums are used.
    proven_s : float
        When the newest proof that succeeded began.
    prove_at_s : float
        When a node that is out is asked next.
    tries : int
        Dialogues since it was last in for a while.
    asked : bool
        Its first dialogue has ended.
    heard_s, emcy_s, trusted_s, began_s, foreign_sdo_s : float
        Newest heartbeat, newest emergency that is not over, newest time of coming in, beginning of its newest dialogue,
        newest SDO request of another master.
    refusal : str
        Why its sums must not be used, empty where nothing is against it.
    dialogue : SdoDialogue or None
        The dialogue under way.
    hint : str
        What explains the next boot.
    in_block_download : bool
        Another master sends it a value in blocks.
    lost_s : float or None
        When it went out; None while it is in, or was never in.
    """

    contract: NodeContract
    settings: Sequence[Setting]
    compared: frozenset[int]
    nmt: int = SILENT
    heard_s: float = -np.inf
    emcy: int = 0
    emcy_s: float = -np.inf
    trusted: bool = False
    trusted_s: float = -np.inf
    proven_s: float = -np.inf
    refusal: str = ""
    dialogue: SdoDialogue | None = None
    began_s: float = -np.inf
    prove_at_s: float = 0.0
    #: Transfers that its last proof took.
    cost: int = 1
    tries: int = 0
    asked: bool = False
    lost_s: float | None = None
    hint: str = ""
    #: The download that another master has begun is of an object that is compared.
    is_sdo_suspect: bool = True
    foreign_sdo_s: float = -np.inf
    in_block_download: bool = False
