"""What `quality` predicts is what a simulated bus gives: frames that carry the sums, arbitration, decoding."""

from pathlib import Path

import numpy as np
import pytest

from bandwidth.quality import heard, is_quick, quality
from dbc.codec import decode
from dbc.contract import Contract
from dbc.dictionary import window_s
from evaluation.schemes.sums import burst
from evaluation.schemes.wire import carry
from gateway.batch import batch_of
from gateway.gathering import Health
from gateway.loop import GatewayLoop
from nodes.simulated import REST_S, Nodes
from nodes.steps.simulated import touched_frames
from reconstructor.imaging import CycleImager
from reconstructor.stepped import SteppedImager
from skin.ground_truth import LATENESS_NS, image_pairs, in_contact
from skin.layout import SHIPPED, Layout, load_layout
from skin.measured_sums import MeasuredSums, decode_stepped
from skin.psnr import decibels
from skin.sources import load_objects
from tests import messages as make
from tests.layouts import any_layout

#: Touches of a layout, seconds.
TOUCHES_S = 4.0
#: What prediction and bus may differ by, decibels.
BOUND_DB = 0.5


def drawn(seed: int) -> Layout:
    """Return a layout of any size, width of sums, rate, turns and wires; sums and samples are chosen."""
    random = np.random.default_rng(seed)
    rows, columns = random.integers(8, 30, 2).tolist()
    size = int(random.choice([16, 32, 64]))
    fd = {"fd": True, "data_bitrate": 2_000_000} if random.random() < 0.5 else {}
    return any_layout(
        rows,
        columns,
        measurement={"block_size": size, "seed": seed},
        encoding={"sum_bits": int(random.integers(7, 17)), "offset_binary": bool(random.random() < 0.5)},
        sync={"rate_hz": float(random.choice([40.0, 100.0, 125.0])), "turns": 1 + seed % 2},
        bus=[{"name": "bus0", "nodes": -(-rows * columns // size), **fd}],
    )


def on_simulated_buses(layout: Layout) -> float:
    """Return the PSNR of the images of sums that simulated buses have carried within their window, decibels.

    Touches and noise are those of the prediction: another noise alone changes four seconds by up to 2 dB.
    """
    contract, taxels = Contract.from_layout(layout), layout.taxels
    nodes = Nodes(layout, load_objects(layout, rest_s=REST_S), seed=0)
    imager, wired, table = CycleImager(layout), contract.phi.is_wired, contract.table
    pairs, counts, errors_n2 = image_pairs(layout), np.zeros(contract.phi.shape[0], np.int32), []
    for cycle in range(round((REST_S + TOUCHES_S) * layout.sync.rate_hz)):
        rows = np.flatnonzero(table.turn == contract.turn_of(cycle % 240 + 1))
        sent = carry(burst(contract, nodes.sample(), rows, cycle % 240 + 1), table.bus[rows], layout.bus, ticks=1)
        ended_ns = int(sent.ended_ns[: rows.size].max())
        assert ended_ns <= 1e9 * window_s(layout)
        decode(sent.frames["data"][: rows.size], table.gather[rows], contract.packing, counts)
        usable = np.frombuffer(contract.packing.usable(counts), np.bool_)
        valid = usable if usable.size else np.ones(counts.size, np.bool_)
        sums = MeasuredSums(counts, contract.phi.all_of_blocks(valid), valid, cycle + 1)
        image = make.image(
            sync_counter=cycle % 240 + 1,
            sampled_mono_ns=nodes.time_ns,
            published_mono_ns=nodes.time_ns + ended_ns + LATENESS_NS,
            pixels=imager.solve(sums)[0].tobytes(),
        )
        for shown, true in (*pairs.take_truth(nodes.truth()), *pairs.take(image)):
            image_n, true_n = (np.frombuffer(each, "<f4") for each in (shown.pixels, true.true))
            if in_contact(true_n, taxels.force_max_n):
                errors_n2.append(np.mean((image_n - true_n)[wired] ** 2))
    return float(decibels(errors_n2, taxels.force_max_n).mean())


def at_the_gateway(layout: Layout) -> float:
    """Return the PSNR of images of what the gateway publishes of steps on simulated buses, decibels."""
    contract, taxels, source = Contract.from_layout(layout), layout.taxels, load_objects(layout)
    buses = range(len(layout.bus))
    said: list[str] = []
    sends = dict.fromkeys(buses, lambda _: None)
    gathering = GatewayLoop(contract, sends, 0.0, say=said.append, complain=said.append).gathering
    for node in contract.nodes:
        gathering.trust(node, proven=True)
    sent = [heard(layout, touched_frames(contract, bus, source, TOUCHES_S), TOUCHES_S) for bus in buses]
    for bus, frames in enumerate(sent):
        gathering.take(batch_of(frames[:0], bus, contract.parts), Health(), 0.0)
    gathering._state.missing[:] = gathering._state.unknown[:] = (
        0  # the boards have answered the gateway, which asks for all sums when it joins
    )
    imager, wired, errors_n2, step_s = SteppedImager(layout), contract.phi.is_wired, [], 0.01
    for step in range(round(TOUCHES_S / step_s)):
        for bus, frames in enumerate(sent):
            first, last = np.searchsorted(frames["time_ns"], [round((step - 1) * 1e7), round(step * 1e7)], side="right")
            gathering.take(batch_of(frames[first:last], bus, contract.parts), Health(), step * step_s)
        came = gathering.measurements(step * step_s, 0)
        if came:
            image_n = imager.solve(decode_stepped(came[-1], contract.phi))[0].ravel()
        true_n = source.frame(step).force_n.ravel()
        if in_contact(true_n, taxels.force_max_n):
            errors_n2.append(np.mean((image_n - true_n)[wired] ** 2))
    return float(decibels(errors_n2, taxels.force_max_n).mean())


@pytest.mark.slow
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_layout_is_predicted(name: str) -> None:
    layout = load_layout(Path(name))
    carried_db = (on_simulated_buses if layout.sends.in_cycles else at_the_gateway)(layout)
    assert quality(layout, touches_s=TOUCHES_S).psnr_image_db == pytest.approx(carried_db, abs=BOUND_DB)


@pytest.mark.heavy
@pytest.mark.parametrize("seed", range(10))
def test_a_drawn_layout_is_predicted(seed: int) -> None:
    layout = drawn(seed)
    assert quality(layout, touches_s=TOUCHES_S).psnr_image_db == pytest.approx(on_simulated_buses(layout), abs=BOUND_DB)


def test_long_predictions_are_not_made_unasked() -> None:
    assert not is_quick(load_layout(Path("steps")))
    assert is_quick(load_layout())
