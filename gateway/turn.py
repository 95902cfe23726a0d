"""What each turn of the gateway does with frames in compiled code: wait, read all buses, look the frames through."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bus.intake import Intake, new_intake, read_links
from bus.told import CAME, DESCRIPTOR, DROPPED, HAS_FAILED, NEEDS_LOOK, READER, STATE
from dbc.frame_fields import Integers
from dbc.stuff_bits import time_of_all_ns
from gateway.batch import sort
from shell.compiled import njit
from skin.layout import Bus


class Turn(NamedTuple):
    """What a turn reads; bus number n is the link number n of `intake`.

    Attributes
    ----------
    intake : Intake
    places : array of int64, shape (buses, frames)
        See `gateway.batch.Batch`.
    is_calm : array of bool, shape (buses,)
        Nothing has happened on a bus but SYNCs of the gateway and frames with sums, if anything.
    is_restless : array of bool, shape (buses,)
        The gateway has to look at the link in the next turn, whatever comes.
    dropped : array of int64, shape (buses,)
        Frames that the links had dropped when the gateway looked last.
    rates : array of int64, shape (buses, 2)
        Nominal and data bit rate.
    busy_ns : array of int64, shape (buses,)
        Time of the frames of calm buses; who counts the load adds to it.
    """

    intake: Intake
    places: npt.NDArray[np.int64]
    is_calm: npt.NDArray[np.bool_]
    is_restless: npt.NDArray[np.bool_]
    dropped: Integers
    rates: Integers
    busy_ns: Integers


def new_turn(buses: Sequence[Bus], busy_ns: Integers) -> Turn:
    """Return what is needed to read some buses, without links yet (`bus.intake.attach`)."""
    intake, count = new_intake(len(buses)), len(buses)
    rates = np.array([(bus.bitrate, bus.data_bitrate or bus.bitrate) for bus in buses], np.int64)
    is_calm, is_restless = np.zeros(count, np.bool_), np.ones(count, np.bool_)
    places = np.empty(intake.rows.shape[:2], np.int64)
    return Turn(intake, places, is_calm, is_restless, np.zeros(count, np.int64), rates, busy_ns)


@njit(cache=True, nogil=True)
def wait_and_sort(rest_ns: int, wait_ns: int, table: Any, turn: Turn) -> int:
    """Wait for frames, and look through those that came; return how many buses are not calm.

    Parameters
    ----------
    rest_ns, wait_ns : int
        See `bus.intake.read_links`.
    table : FrameTable or PartTable
    """
    read_links(rest_ns, wait_ns, turn.intake)
    restless = 0
    for bus in range(turn.is_calm.size):
        told, rows = turn.intake.told[bus], turn.intake.rows[bus, : turn.intake.told[bus, CAME]]
        is_calm = told[DESCRIPTOR] >= 0 and told[READER] and not (told[HAS_FAILED] or told[STATE] or told[NEEDS_LOOK])
        is_calm &= not turn.is_restless[bus] and told[DROPPED] == turn.dropped[bus]
        if is_calm and told[CAME]:
            tells_loss, echoes, other_syncs, talk = sort(rows, bus, table, turn.places[bus])
            is_calm = not (tells_loss or echoes or other_syncs or len(talk))
            if is_calm:
                turn.busy_ns[bus] += time_of_all_ns(rows, turn.rates[bus, 0], turn.rates[bus, 1])
        turn.is_calm[bus] = is_calm
        restless += not is_calm
    return restless
