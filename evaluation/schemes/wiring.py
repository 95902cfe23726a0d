"""What wires cost: length of the chains of taxels against the quality of images, with and without a dead board."""

from typing import Final

import numpy as np
import numpy.typing as npt

import bandwidth.wiring
from evaluation.result import Options, Result, Row, grouped
from evaluation.result_cache import measure_cells
from reconstructor.engine import Reconstructor
from reconstructor.settings import VARIATION
from skin.layout import parse_layout
from skin.psnr import psnr_series_db
from skin.taxel import sense
from touch.trajectory import trajectory

#: Taxels of a block, and the region that holds a block as the keys of a layout; 64 x 64 taxels, 1024 sums.
WIRINGS: Final[dict[str, tuple[int, str]]] = {
    **{f"whole skin, B = {size}": (size, "") for size in (8, 16, 32, 64, 128)},
    **{f"{side} x {side}, B = 32": (32, f"patch = {side}") for side in (32, 16, 8)},
    "4 x 8 neighbours": (32, "wiring = 'board'"),
}
#: One step in `SPEED` of the trajectory is measured: 420 of 4200.
SPEED: Final = 10
QUICK_SPEED: Final = 300
#: Draws of a dead board. The board is one that the object touches.
DEAD_BOARDS: Final = 4


def evaluate(options: Options) -> Result:
    """Return a row for each wiring: metres, mean PSNR of total variation over the objects, loss by a dead board."""
    asked: Row = {**options.shared, "speed": QUICK_SPEED if options.quick else SPEED}
    asked["dead_boards"] = 1 if options.quick else DEAD_BOARDS
    cells = [{**asked, "name": name, "wiring": each} for name in options.objects for each in WIRINGS]
    found = measure_cells(measure, cells, options, "images")
    rows = []
    for (name,), group in grouped(found, "wiring").items():
        losses_db = np.concatenate([each["losses_db"] for each in group])
        rows.append(
            {
                "wiring": name,
                "boards": group[0]["boards"],
                "all_m": round(group[0]["all_m"], 1),
                "longest_m": round(group[0]["longest_m"], 2),
                "psnr_db": round(float(np.mean([each["psnr_db"] for each in group])), 2),
                "dead_board_db": round(float(losses_db.mean()), 2) + 0.0,
                "dead_board_most_db": round(float(losses_db.max()), 2) + 0.0,
            }
        )
    note = (
        "all_m, longest_m: chains of taxels, 4 mm apart, each to the nearest taxel that is left. dead_board_db: mean "
        "loss of PSNR by one dead board while the object touches it; dead_board_most_db: by the worst of those drawn."
    )
    return Result("Wires: length, quality and dead boards, 64 x 64 taxels, 1024 sums", rows, note=note)


def measure(*, name: str, meshes: str | None, seed: int, speed: int, wiring: str, dead_boards: int) -> Row:
    """Return metres and PSNR of one object and wiring, and the loss by each dead board while the object touches it."""
    size, keys = WIRINGS[wiring]
    text = f"[taxels]\nrows = 64\ncolumns = 64\n[measurement]\nsums = 1024\nblock_size = {size}\n{keys}\n"
    # At this rate the fewest buses carry the sums: wires are judged here.
    layout = parse_layout(f"{text}[sync]\nrate_hz = 1.0\n[sampling]\nrate_hz = 1.0\n".encode(), wiring)
    phi, wires = layout.phi(), bandwidth.wiring.wiring(layout)
    true = trajectory(name, meshes=meshes, speed=speed)
    random = np.random.default_rng(seed)
    felt = sense(true, random).reshape(len(true), -1)
    sums_n = phi.forward(felt).astype(np.float32)
    # (frames, boards)
    is_touched: npt.NDArray[np.bool_] = np.logical_or.reduce(
        (true.reshape(len(true), -1) > 0)[:, phi.taxels_of_blocks], axis=2
    )
    engine = Reconstructor(phi, layout.taxels.rows, layout.taxels.columns, VARIATION)

    def psnr_db(valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        engine.restart()
        return psnr_series_db(true, [engine.solve(each, phi.sums_of_blocks(valid)) for each in sums_n])

    all_db = psnr_db(np.ones(phi.blocks, np.bool_))
    dead = random.permutation(np.flatnonzero(is_touched.any(axis=0)))[:dead_boards]
    losses_db = [all_db - psnr_db(np.arange(phi.blocks) != board) for board in dead]
    return {
        "wiring": wiring,
        "boards": phi.blocks,
        "all_m": wires.wires_m,
        "longest_m": wires.longest_chain_m,
        "psnr_db": float(all_db.mean()),
        "losses_db": [float(lost[is_touched[:, board]].mean()) for board, lost in zip(dead, losses_db, strict=True)],
    }
