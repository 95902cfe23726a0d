"""Of recorded frames of a skin with two states: which state the gateway asks for, and in which state nodes send."""

from typing import Final

import numpy as np

from dbc.canopen import BASE_ID_MASK, STATE_COB_ID
from dbc.contract import Contract
from dbc.dictionary import SkinState
from dbc.frame import ERROR, EXTENDED, FD, REMOTE, Frames

#: The states of `Contract.states`, in its order.
STATES: Final = (SkinState.IMAGES, SkinState.RECOGNITION)


def asked_states(seen: Frames) -> list[tuple[int, SkinState]]:
    """Return place and state of each frame that asks for a state (2008h:1); it holds from the next SYNC on."""
    is_asking = (seen["can_id"] == STATE_COB_ID) & (seen["length"] == 1) & (seen["data"][:, 0] <= max(SkinState))
    is_asking &= seen["flags"] & (EXTENDED | REMOTE | ERROR | FD) == 0
    places = np.flatnonzero(is_asking)
    states = map(SkinState, seen["data"][places, 0].tolist())
    return list(zip(places.tolist(), states, strict=True))


def sent_state(contract: Contract, bus: int, seen: Frames) -> SkinState | None:
    """Return the state of the first frame of sums on a bus, None without such a frame."""
    is_known = (seen["flags"] & (EXTENDED | REMOTE | ERROR) == 0) & (seen["can_id"] <= BASE_ID_MASK)
    can_id = seen["can_id"][is_known]
    firsts = [np.flatnonzero(state.table.row_of[bus, can_id] >= 0)[:1].tolist() for state in contract.states]
    found = [(places[0], state) for places, state in zip(firsts, STATES, strict=False) if places]
    return min(found)[1] if found else None
