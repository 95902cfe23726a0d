"""C boards that average what they sample between two SYNCs, beside Python nodes that get the same samples.

Both round in their own order, so sums may differ by a count. Where the average of a taxel is at the edge of what counts
as noise, one of them may send 0 for it.
"""

import numpy as np
import numpy.typing as npt

from dbc.canopen import SDO_REQUEST_BASE, SDO_RESPONSE_BASE
from dbc.codec import decode
from dbc.contract import Contract
from skin.sources import Frame
from skin.taxel import NOISE_N
from tests.nodes.firmware.twins import Twins, needs_compiler, small_contract

pytestmark = needs_compiler

AVERAGING = {"sampling": {"rate_hz": 1000.0}, "encoding": {"sum_bits": 16}}
#: Two thirds of the force below which an average is taken for noise, in counts: what one taxel may differ by.
EDGE_COUNTS = 16


class Sliding:
    """A wave that goes over the first rows of an idle skin."""

    has_noise = False

    def __init__(self, contract: Contract) -> None:
        self._taxels = contract.layout.taxels

    def frame(self, step: int) -> Frame:
        force_n = np.zeros((self._taxels.rows, self._taxels.columns), np.float32)
        phase = (step - 60) / 20 + np.arange(self._taxels.columns) / 5
        if step > 60:
            force_n[:3] = np.clip(0.006 * np.sin(phase), 0, None)
        return Frame(force_n, "")


def sums_of(twins: Twins) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return the sums that both have sent at the newest SYNC."""
    table, packing = twins.contract.table, twins.contract.packing
    found = []
    for link in twins.links:
        sums, sent = np.zeros(twins.contract.phi.shape[0], np.int32), link.take_sent()
        for one in sent[sent["can_id"] < SDO_RESPONSE_BASE]:
            decode(one["data"][None], table.gather[table.row_of[0, one["can_id"]]][None], packing, sums)
        found.append(sums)
    return found[0], found[1]


def test_sums_are_those_of_the_same_averages() -> None:
    contract = small_contract(**AVERAGING)
    twins = Twins(contract, noise_n=NOISE_N, source=Sliding(contract))
    twins.nmt(1)
    sums_of(twins)
    differences, largest = [], 0
    for turn in range(250):
        twins.now_s += 0.01
        twins.sync(turn % 240 + 1)
        python, c = sums_of(twins)
        largest = max(largest, int(np.abs(python).max()))
        differences.append(np.abs(python - c)[: contract.phi.starts[2]])
    found = np.array(differences)
    assert largest > 500
    assert (found <= 1).mean() > 0.98
    assert found.max() <= 2 * EDGE_COUNTS


def test_gains_act_on_averages_patterns_replace_them_and_a_reset_begins_anew() -> None:
    contract = small_contract(**AVERAGING)
    twins = Twins(contract, noise_n=NOISE_N, source=Sliding(contract))
    twins.nmt(1)
    for turn, request in enumerate(
        (
            b"\x23\x10\x20\x05" + np.float32(1.7).tobytes(),
            b"\x2b\x11\x20\x09\x28\x00\x00\x00",
            b"\x2f\x21\x20\x00\x02\x00\x00\x00",
            b"\x2f\x21\x20\x00\x00\x00\x00\x00",
            None,
        )
    ):
        if request is None:
            twins.nmt(129, 1)
            twins.nmt(1, 1)
        else:
            twins.put(SDO_REQUEST_BASE + 1, request)
        for cycle in range(30):
            twins.now_s += 0.01
            twins.sync(30 * turn + cycle + 1)
            python, c = sums_of(twins)
            assert np.abs(python - c)[: contract.phi.starts[2]].max() <= EDGE_COUNTS
        if turn == 2:  # the pattern is exact
            first = slice(0, contract.phi.starts[1])
            assert np.array_equal(c[first], python[first])
