"""The sums of every cycle: of a CAN log, decoded by the gateway's loop, of a recording of forces, or of a file."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import MEASUREMENT, CycleMeasurement, FrameCounts, Measurement
from dbc.contract import Contract
from dbc.frame import Frames
from dbc.packing import packing
from gateway.playback import check_named, play
from nodes.analogue import AnalogueElectronics
from nodes.electronics import Electronics
from recording.mcap_file import Warn, read_messages, wall_offset_ns
from skin.layout import Layout
from skin.matrix import MatrixPhi
from skin.measured_sums import check_measurement, used_blocks, used_sums
from skin.measurement import Phi
from touch.sources import recording

#: The array of an .npz of sums, and those that may stand beside it.
SUMS: Final = "sums"
_BESIDE: Final = ("valid", "cycle", "time_ns")
_MOST_COUNTS: Final = int(np.iinfo(np.int32).max)


@dataclass(frozen=True, eq=False)
class Cycles:
    """Measured cycles of one skin, in the order of time.

    Attributes
    ----------
    counts : array of int32, shape (cycles, m)
        Sums in ADC counts, 0 where invalid.
    valid : array of bool, shape (cycles, blocks)
        True if every sum of the block came in this cycle, and all are usable.
    valid_sums : array of bool, shape (cycles, m)
        True if the sum came and is usable: one that saturates costs its block, and none of the others.
    time_ns : array of int64, shape (cycles,)
        Time of the SYNC: on the clock of the log; of a recording, from 0.
    cycle : array of int64, shape (cycles,)
        Number of the cycle, from 1: it tells the Φ that changes from frame to frame.
    """

    counts: npt.NDArray[np.int32]
    valid: npt.NDArray[np.bool_]
    valid_sums: npt.NDArray[np.bool_]
    time_ns: npt.NDArray[np.int64]
    cycle: npt.NDArray[np.int64]


def decode_log(
    contract: Contract, logged: Mapping[int, Frames], advance: Callable[[int], None]
) -> tuple[Cycles, FrameCounts]:
    """Return the cycles of a log, and how its frames were counted.

    See `gateway.playback` for which blocks are valid.

    Parameters
    ----------
    logged : mapping of int to Frames
        Frames by the number of their bus, in the order of the log.
    advance : callable
        Called with the number of further decoded cycles.
    """
    made: list[Measurement] = []
    for part in play(contract, logged):
        made += part.measurements
        advance(len(part.measurements))
    check_named(part.status)
    return _of_measurements(made, contract.phi), part.status.frames


def recorded_cycles(contract: Contract, path: Path, warn: Warn) -> Cycles:
    """Return the cycles of a recording by its measurements; times as of its frames."""
    phi = contract.phi
    read = [each.message for each in read_messages(path, [MEASUREMENT], warn)]
    made = [check_measurement(each, phi, CycleMeasurement) for each in read if each.fingerprint == phi.fingerprint]
    if not made:
        why = "they are of another Φ: is this the skin's layout?" if read else "there is nothing to rebuild"
        raise InputError(f"{path}: holds neither frames nor measurements of '{contract.layout.name}': {why}")
    cycles = _of_measurements(made, phi)
    return replace(cycles, time_ns=cycles.time_ns + wall_offset_ns(path))


def _of_measurements(made: Sequence[Measurement], phi: Phi) -> Cycles:
    counts = np.stack([np.frombuffer(each.sums, "<i4") for each in made])
    valid, valid_sums = (np.stack([of(each, phi) for each in made]) for of in (used_blocks, used_sums))
    time_ns, cycle = (
        np.array(each, np.int64) for each in zip(*((m.sampled_mono_ns, m.cycle) for m in made), strict=True)
    )
    return Cycles(counts, valid, valid_sums, time_ns, cycle)


def read_sums(layout: Layout, path: Path) -> Cycles:
    """Read the sums of a skin from a file that a program has written.

    Parameters
    ----------
    path : pathlib.Path
        ``.npz``: ``sums``, integers, ADC counts, shape (cycles, m); and what is known of ``valid``, bool, shape
        (cycles, m), default all; ``cycle``, the numbers of the cycles, default 1, 2, 3 and so on; ``time_ns``, default
        that of the cycles from 0.
    """
    phi = layout.operator()
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
            found = {name: np.asarray(arrays[name]) for name in arrays.files if name in {SUMS, *_BESIDE}}
    except Exception as error:  # the zip and npy decoders raise many kinds of errors
        raise InputError(f"{path}: cannot be read as .npz: {' '.join(str(error).split())}") from error
    sums = found[SUMS]
    if sums.dtype.kind not in "iu" or sums.shape[1:] != phi.shape[:1] or not len(sums):
        expected = f"expected integers, ADC counts, of shape (cycles, {phi.shape[0]})"
        raise InputError(f"{path}: 'sums': {expected}, got {sums.dtype} of shape {sums.shape}")
    if abs(int(sums.max())) > _MOST_COUNTS or abs(int(sums.min())) > _MOST_COUNTS:
        raise InputError(f"{path}: 'sums': expected up to {_MOST_COUNTS} counts, got {sums.min()} to {sums.max()}")
    cycle = found.get("cycle", np.arange(1, len(sums) + 1))
    time_ns = found.get("time_ns", np.rint((cycle - cycle[:1]) * (1e9 * layout.sync.period_s)).astype(np.int64))
    valid = found.get("valid", np.ones(sums.shape, np.bool_))
    for name, each, kinds, shape in (
        ("cycle", cycle, "iu", sums.shape[:1]),
        ("time_ns", time_ns, "iu", sums.shape[:1]),
        ("valid", valid, "b", sums.shape),
    ):
        if each.dtype.kind not in kinds or each.shape != shape:
            wanted = "booleans" if kinds == "b" else "integers"
            raise InputError(f"{path}: '{name}': expected {wanted} of shape {shape}, got {each.dtype} of {each.shape}")
    blocks = np.array([phi.all_of_blocks(each) for each in valid]) & phi.has_sums
    counts = np.where(blocks[:, phi.block_of_sum], sums, 0).astype(np.int32)
    return Cycles(counts, blocks, blocks[:, phi.block_of_sum], time_ns.astype(np.int64), cycle.astype(np.int64))


def measure_forces(
    layout: Layout,
    path: Path,
    arrays: Sequence[str] | None,
    full_scale: float | None,
    advance: Callable[[int], None],
) -> Cycles:
    """Measure every frame of a recording of forces in one cycle, with the ADC, Φ and packing of the nodes.

    Every block with sums is valid unless one saturates. Sums of a matrix are those of the ADC's counts.

    Parameters
    ----------
    path : pathlib.Path
        ``.npz``, ``.npy`` or ``.csv``, see `touch.reading`. No noise is added: the values contain a sensor's noise.
    arrays : sequence of str, optional
        Arrays of an ``.npz`` to place side by side.
    full_scale : float, optional
        The recorded value that becomes the taxels' largest force; default: the largest value of the recording.
    advance : callable
        Called with the number of further measured frames.
    """
    taxels, phi = layout.taxels, layout.operator()
    source = recording(
        path, taxels.rows, taxels.columns, full_scale=full_scale, force_max_n=taxels.force_max_n, arrays=arrays
    )
    read, packed = _reader(layout), None if isinstance(phi, MatrixPhi) else packing(layout)
    counts = np.empty((source.frames, phi.shape[0]), np.int32)
    valid = np.tile(phi.has_sums, (source.frames, 1))
    valid_sums = np.ones(counts.shape, np.bool_)
    for step in range(source.frames):
        counts[step] = read(source.frame(step).force_n, step + 1)
        if packed is not None:
            counts[step] = packed.counts(packed.raw(counts[step]))
        if packed is not None and (usable := packed.usable(counts[step])):
            valid_sums[step] = np.frombuffer(usable, np.bool_)
            valid[step, phi.block_of_sum[~valid_sums[step]]] = False
        advance(1)
    time_ns = np.rint(np.arange(source.frames) * (1e9 * layout.sync.period_s)).astype(np.int64)
    return Cycles(counts, valid, valid_sums, time_ns, np.arange(1, source.frames + 1))


def _reader(layout: Layout) -> Callable[[npt.NDArray[np.float32], int], npt.NDArray[np.int32]]:
    """Return what makes the sums of a cycle, counts of shape (m,), of forces of shape (rows, columns)."""
    any_phi = layout.operator()
    if isinstance(any_phi, MatrixPhi):
        taxels = Electronics(layout.taxels, noise_n=0.0)
        return lambda force_n, cycle: any_phi.of_cycle(cycle).forward(taxels.read(force_n))
    phi = any_phi
    if layout.taxels.is_analogue:
        boards = AnalogueElectronics(layout, phi, noise_n=0.0)
        return lambda force_n, _cycle: boards.read_sums(force_n, None, 0)
    electronics = Electronics(layout.taxels, noise_n=0.0, places=phi.wired.taxels)
    return lambda force_n, _cycle: phi.wired.forward(electronics.read(force_n)).astype(np.int32, copy=False)
