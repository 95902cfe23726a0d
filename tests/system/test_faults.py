"""Every fault a bus can have at once: what is called valid is exactly what the taxels gave in that very cycle."""

import numpy as np
import pytest

from canskin.messages import TRUTH, Measurement, Truth
from dbc.packing import packing
from skin.ground_truth import of_one_cycle
from tests.system.conftest import Chain, invalid_blocks

pytestmark = pytest.mark.slow

CYCLES = 120
#: SYNC comes every 50 ms; the delay carries frames across one.
FAULTS = (
    "controller=nodes:*,loss_ratio=0.003",
    "controller=nodes:*,duplicate_ratio=0.003",
    "controller=nodes:*,delay_ratio=0.01,delay_s=0.06",
    "controller=nodes:*,bit_error_rate=0.00001",
    "controller=gateway:*,can_id=0x80,mask=0x7FF,loss_ratio=0.05",
)


def check(chain: Chain, measurement: Measurement, truth: Truth) -> None:
    """Compare the sums of valid blocks with those of the sensor image, rounded as sent."""
    carried = packing(chain.layout)
    sensor = np.frombuffer(truth.sensor, "<f4") / chain.layout.taxels.newton_per_count
    expected = carried.counts(carried.raw(chain.phi.forward(np.rint(sensor).astype(np.int32))))
    valid = np.frombuffer(measurement.valid, np.uint8) != 0
    wanted = chain.phi.sums_of_blocks(valid)
    sums = np.frombuffer(measurement.sums, "<i4")
    wrong = np.unique(chain.phi.block_of_sum[wanted & (sums != expected)])
    assert not wrong.size, f"cycle {measurement.cycle}: blocks {wrong.tolist()} are not of this cycle"
    assert not sums[~wanted].any()


def test_valid_means_of_this_cycle(chain: Chain) -> None:
    truths: list[Truth] = []
    chain.fabric.subscribe(TRUTH, truths.append)
    chain.start_bus("--seed", "5", *(part for fault in FAULTS for part in ("--fault", fault)))
    chain.start("nodes", "nodes", "--objects", "granola-box")
    chain.until_alive("nodes")
    chain.start("gateway", "gateway")
    chain.until("a cycle", lambda: len(chain.measurements) > 0)
    measured = chain.next_measurements(CYCLES)
    compared = 0
    for measurement in measured:
        period_s = chain.layout.sync.period_s
        truth = next((each for each in truths if of_one_cycle(measurement, each, period_s)), None)
        if truth is not None:
            check(chain, measurement, truth)
            compared += 1
    assert compared > CYCLES / 2
    hurt = sum(bool(invalid_blocks(measurement)) for measurement in measured)
    assert hurt > CYCLES / 4
    chain.until("late frames", lambda: chain.gateway is not None and chain.gateway.frames.late > 0)
    assert chain.gateway is not None
    assert chain.gateway.frames.duplicate > 0
