"""What `quality` predicts is what a simulated bus gives: frames that carry the sums, arbitration, decoding."""

from pathlib import Path

import numpy as np
import pytest

from dbc.codec import decode
from dbc.contract import Contract
from dbc.dictionary import window_s
from demo.chain import REST_S, Nodes
from demo.quality import quality
from evaluation.schemes.sums import burst
from evaluation.schemes.wire import carry
from reconstructor.imaging import CycleImager
from skin.ground_truth import in_contact
from skin.layout import SHIPPED, Layout, changed, load_layout
from skin.measured_sums import MeasuredSums
from skin.psnr import decibels
from skin.sources import load_objects
from tests.layouts import any_layout

#: Touches of a layout, seconds.
TOUCHES_S = 4.0
#: What prediction and bus may differ by, decibels.
BOUND_DB = 0.5
IN_CYCLES = [name for name in SHIPPED if load_layout(Path(name)).sends.in_cycles]


def drawn(seed: int) -> Layout:
    """Return a layout of any size, width of sums, rate and wires; sums and samples are chosen."""
    random = np.random.default_rng(seed)
    rows, columns = random.integers(8, 30, 2).tolist()
    size = int(random.choice([16, 32, 64]))
    fd = {"fd": True, "data_bitrate": 2_000_000} if random.random() < 0.5 else {}
    return any_layout(
        rows,
        columns,
        measurement={"block_size": size, "seed": seed},
        encoding={"sum_bits": int(random.choice([16, 12, 8])), "offset_binary": bool(random.random() < 0.5)},
        sync={"rate_hz": float(random.choice([40.0, 100.0, 125.0]))},
        bus=[{"name": "bus0", "nodes": -(-rows * columns // size), **fd}],
    )


def on_simulated_buses(layout: Layout) -> float:
    """Return the PSNR of the images of sums that simulated buses have carried within their window, decibels.

    Touches and noise are those of the prediction: another noise alone changes four seconds by up to 2 dB.
    """
    layout = changed(layout, recognition=None)
    contract, taxels = Contract.from_layout(layout), layout.taxels
    nodes = Nodes(layout, load_objects(layout, rest_s=REST_S), seed=0)
    imager, wired, table = CycleImager(layout), contract.phi.is_wired, contract.table
    errors_n2 = []
    for cycle in range(round((REST_S + TOUCHES_S) * layout.sync.rate_hz)):
        rows = np.flatnonzero(table.phase == cycle % contract.phases)
        sent = carry(burst(contract, nodes.sample(), rows), table.bus[rows], layout.bus, ticks=1)
        assert sent.ended_ns[: rows.size].max() <= 1e9 * window_s(layout)
        counts = np.zeros(contract.phi.shape[0], np.int32)
        decode(sent.frames["data"][: rows.size], table.gather[rows], contract.packing, counts)
        usable = np.frombuffer(contract.packing.usable(counts), np.bool_)
        valid = usable if usable.size else np.ones(counts.size, np.bool_)
        sums = MeasuredSums(counts, contract.phi.all_of_blocks(valid), valid, cycle + 1)
        image_n, true_n = imager.solve(sums)[0].ravel(), np.frombuffer(nodes.truth().true, "<f4")
        if in_contact(true_n, taxels.force_max_n):
            errors_n2.append(np.mean((image_n - true_n)[wired] ** 2))
    return float(decibels(errors_n2, taxels.force_max_n).mean())


@pytest.mark.slow
@pytest.mark.parametrize("name", IN_CYCLES)
def test_a_shipped_layout_is_predicted(name: str) -> None:
    layout = load_layout(Path(name))
    assert quality(layout, touches_s=TOUCHES_S).psnr_image_db == pytest.approx(on_simulated_buses(layout), abs=BOUND_DB)


@pytest.mark.heavy
@pytest.mark.parametrize("seed", range(10))
def test_a_drawn_layout_is_predicted(seed: int) -> None:
    layout = drawn(seed)
    assert quality(layout, touches_s=TOUCHES_S).psnr_image_db == pytest.approx(on_simulated_buses(layout), abs=BOUND_DB)
