"""``skin evaluate noiselets``: the paper's second ensemble as frames on buses: nodes of rows, and a node that mixes."""

from dataclasses import replace
from itertools import product
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from bandwidth.mean_bits import mean_wire_bits
from evaluation.paper.runs import (
    NOISELET_PENALTY_N,
    OBJECTS,
    RECONSTRUCTIONS,
    SIDE,
    Method,
    felt_force,
    phi_seed,
    rebuilt_images,
    summary,
    true_force,
)
from evaluation.paper.tables import QUICK_STRIDES, TABLE_ITERATIONS, TABLE_SUMS
from evaluation.result import Options, Result, Row
from evaluation.result_cache import measure_cells
from evaluation.solvers.noiselet import Noiselet, noiselet
from evaluation.solvers.noiselet_solver import NoiseletSolver
from reconstructor.settings import PAPER
from skin.layout import load_layout
from skin.psnr import psnr_series_db

STRIDE: Final = 4
SBHE: Final = "SBHE, B = 32"
#: Noiselet matrices of 1024 products: rows of N along the columns of taxels (u) and along the rows (v) that are kept,
#: None for products that are drawn alone, as the paper draws them.
KEPT: Final[dict[str, tuple[int, int] | None]] = {
    "noiselets, products drawn": None,
    "noiselets, 32 x 32": (32, 32),
    "noiselets, 64 x 16": (64, 16),
}
FRAME_BYTES: Final = 8


class Stage(NamedTuple):
    """Nodes, the values that each node sends in a cycle, and the bits of a value."""

    nodes: int
    values: int
    bits: int

    @property
    def frames(self) -> int:
        """Frames of a cycle; the values of a node are packed without gaps."""
        return self.nodes * -(-self.values * self.bits // (8 * FRAME_BYTES))


def evaluate(options: Options) -> Result:
    """Return a row for SBHE and for each kind of noiselet: frames, bits, time, sums lost with a frame, PSNR."""
    stride = QUICK_STRIDES["haar"] if options.quick else STRIDE
    cells = [
        {**options.shared, "name": name, "kind": kind, "stride": stride}
        for kind, name in product((SBHE, *KEPT), OBJECTS)
    ]
    found = measure_cells(measure, cells, options, RECONSTRUCTIONS)
    rows = []
    for place, kind in enumerate((SBHE, *KEPT)):
        group = found[place * len(OBJECTS) : (place + 1) * len(OBJECTS)]
        rows.append(
            traffic(kind, options.seed) | {"psnr_db": round(float(np.mean([each["mean"] for each in group])), 2)}
        )
    note = (
        "Exact integers of 10-bit taxels, packed without gaps into classic frames of 8 bytes with random data; four "
        "buses of 1 Mbit/s at the default rate. The mixing node begins when the last row has come. ms: bits of both "
        "stages / four buses. lost: sums with a value of one lost frame of the first stage. psnr_db: means over the "
        "five objects, Haar, 20 iterations, one draw."
    )
    return Result("Noiselets on the bus: nodes of rows and a mixing node", rows, note=note)


def stages(kind: str) -> tuple[Stage, ...]:
    """Return the stages of a kind, the first on the boards of the taxels."""
    layout = load_layout()
    if kind == SBHE:
        return (Stage(layout.blocks, TABLE_SUMS // layout.blocks, signed_bits(layout.measurement.block_size)),)
    kept = KEPT[kind]
    rows = Stage(SIDE, SIDE if kept is None else kept[1], signed_bits(SIDE))
    # With all rows of N along the columns the second stage only turns what it gets: the receiver can do without.
    return (rows,) if kept and kept[0] == SIDE else (rows, Stage(1, TABLE_SUMS, signed_bits(SIDE * SIDE)))


def signed_bits(taxels: int) -> int:
    """Return the bits of a signed integer that holds every ±1 sum of `taxels` taxels, counts of the converter."""
    largest = taxels * ((1 << load_layout().taxels.adc_bits) - 1)
    return 1 + largest.bit_length()


def traffic(kind: str, seed: int) -> Row:
    """Return the row of a kind but for its PSNR."""
    layout, each = load_layout(), stages(kind)
    bits = sum(stage.frames for stage in each) * sum(mean_wire_bits(FRAME_BYTES))
    buses_bits_per_s = sum(bus.bitrate for bus in layout.bus)
    second = each[1] if len(each) > 1 else None
    return {
        "ensemble": kind,
        "values": each[0].nodes * each[0].values,
        "bits": each[0].bits,
        "frames": each[0].frames,
        "mixed_bits": second.bits if second else None,
        "mixed_frames": second.frames if second else None,
        "kbit_per_s": round(bits * layout.sync.rate_hz / 1e3),
        "ms": round(1e3 * bits / buses_bits_per_s, 1),
        "lost": lost_sums(kind, seed),
    }


def lost_sums(kind: str, seed: int) -> int:
    """Return the most sums with a value of one lost frame of the first stage."""
    first = stages(kind)[0]
    frame = np.arange(first.values) * first.bits // (8 * FRAME_BYTES)
    last = ((np.arange(first.values) + 1) * first.bits - 1) // (8 * FRAME_BYTES)
    frames = range(int(last[-1]) + 1)
    if kind == SBHE:
        return max(int(np.count_nonzero((frame <= each) & (each <= last))) for each in frames)
    column = phi_of(kind, seed).kept % SIDE
    # A value of one row is in every product of its column; without a second stage only in itself.
    sums = np.array([np.count_nonzero(column == each) for each in np.unique(column)])
    if len(stages(kind)) == 1:
        sums = np.ones_like(sums)
    return max(int(sums[(frame <= each) & (each <= last)].sum()) for each in frames)


def phi_of(kind: str, seed: int) -> Noiselet:
    """Return the first draw of a noiselet with 1024 products."""
    kept = KEPT[kind]
    if kept is None:
        return noiselet(SIDE, SIDE, TABLE_SUMS, seed=phi_seed(seed, 0))
    random = np.random.default_rng(phi_seed(seed, 0))
    u, v = (np.sort(random.permutation(SIDE)[:count]) for count in kept)
    places: npt.NDArray[np.intp] = (u[:, None] * SIDE + v).ravel()
    return Noiselet(SIDE, SIDE, places)


def measure(*, name: str, meshes: str | None, kind: str, stride: int, seed: int) -> Row:
    """Return mean, least and largest PSNR of the images of one draw, dB."""
    true = true_force(name, meshes, stride)
    if kind == SBHE:
        phi, solver = Method("sbhe", TABLE_SUMS, "haar", TABLE_ITERATIONS).make(phi_seed(seed, 0))
        return summary(psnr_series_db(true, rebuilt_images(phi, solver, felt_force(true, seed, 0))))
    settings = replace(PAPER, iterations=TABLE_ITERATIONS, penalty_n=NOISELET_PENALTY_N)
    drawn = phi_of(kind, seed)
    images = rebuilt_images(drawn, NoiseletSolver(drawn, settings), felt_force(true, seed, 0))
    return summary(psnr_series_db(true, images))
