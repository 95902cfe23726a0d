"""``skin rebuild``: the images of a whole recording or CAN log."""

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from bus.options import Channels
from calibration.calibrator import Tare
from calibration.offline import OffsetSource, calibrated_cycles, make_calibrator
from calibration.recorded import RecordedOffsets
from canskin.errors import InputError, RunError, reasoned
from canskin.messages import IMAGE, FrameCounts
from dbc.contract import Contract
from reconstructor.engine import reconstruct
from reconstructor.gains import KnownGains
from reconstructor.imaging import Imager, load_gains, make_imager
from reconstructor.options import SolverOptions
from recording import is_recording
from recording.answers import same_pixels
from recording.cycles import SUMS, Cycles, decode_log, measure_forces, read_sums, recorded_cycles
from recording.mcap_file import read_messages, read_topics, recording_id, wall_offset_ns
from recording.step_kinds import MeasurementStep
from recording.steps import frames_of_log, has_frames, steps_of
from shell.output import check_new_path, replacing
from shell.service import say
from shell.terminal import progress
from shell.touch_options import ArrayNames, FullScale
from skin.layout import Layout, load_layout, require_sending
from skin.wall_times import nearest, recorded_clocks, recorded_wall_times
from touch.reading import array_names

#: ``--calibration none``: take nothing off.
NO_CALIBRATION: Final = Path("none")

Bools = npt.NDArray[np.bool_]
Sums = npt.NDArray[np.float32]
Images = npt.NDArray[np.float32]
Numbers = npt.NDArray[np.int64]
#: Makes the images of sums, their validity, each of shape (cycles, m), and the cycles' numbers; tells its progress.
_Solve = Callable[[Sums, Bools, Numbers, Callable[[int], None]], Images]
#: First words of a .csv log of python-can.
_CAN_CSV: Final = b"timestamp,arbitration_id"


def rebuild(
    source: Path,
    *,
    out: Path,
    layout: Path | None = None,
    solver: SolverOptions | None = None,
    channel: Channels | None = None,
    array: ArrayNames = None,
    full_scale: FullScale = None,
    calibration: Path | None = None,
    tare: Tare = "never",
    gains: Path | None = None,
) -> None:
    """Make the tactile image of every cycle of a recording or a CAN log, and write all images to one file.

    A CAN log is decoded as in the gateway: blocks with late, damaged or missing frames are not valid in that cycle.
    The offsets in a run of ``skin record`` are taken off. A recording is measured as in the nodes, one frame per
    cycle. Images equal those of ``skin reconstruct``, but for rounding on a GPU and in the first images of the parts
    that are solved there together; the log tells how many equal those of the run. Each image begins with the one
    before. So after the beginning of a recording of a touched skin, and after a cycle that the live reconstructor left
    out, images differ for up to hundreds of cycles, longest where sums are saturated. Of steps the images of the run
    are made again, of a log one every 10 ms.

    Parameters
    ----------
    source
        A CAN log: candump -l, .asc, .blf or any other that python-can reads; a recording (.mcap), by its measurements
        where it has no frames, as those of the page; a recording of forces: .npz, .npy or .csv of shape (time, rows,
        columns); or sums that a program has written: .npz with ``sums``, counts, shape (cycles, sums), and what is
        known of ``valid``, ``cycle`` and ``time_ns``.
    out
        New .npz for the images: ``images`` float32 (cycles, rows, columns) in newtons, ``valid`` bool (cycles,
        blocks), ``time_ns`` and ``cycle`` int64 (cycles,), ``recording``, ``metadata`` JSON.
    layout
        TOML of the skin; default: the layout in the .mcap, else the default skin.
    solver
        Solver of the images.
    channel
        Channels of the log, one per bus. Default: the names of the buses, else all channels in their order.
    calibration
        File of ``skin calibration save``, or a recording, whose newest offsets are taken off all cycles; or ``none``.
        Default: the offsets that were recorded with each cycle.
    tare
        ``at-start``: measure the offsets as the gateway does, once the skin is untouched for 2 s or 64 cycles.
    gains
        As of ``skin reconstruct``.

    Examples
    --------
    skin rebuild candump-2026-11-20_120000.log --out images.npz
    skin rebuild mat.npz --array S1 S2 --full-scale 4095 --out images.npz --solver spun
    skin rebuild sums.npz --layout wire.toml --out images.npz
    """
    is_forces = _is_recording(source)
    _check_options(is_forces, channel, array, full_scale)
    check_new_path(out, "images", ".npz")
    if layout is None and is_recording(source):
        layout = source
    skin = load_layout(layout)
    stored = None if calibration == NO_CALIBRATION else calibration
    calibrator = make_calibrator(skin, stored, tare, "rebuild")
    options = solver or SolverOptions()
    about: dict[str, Any]
    if not skin.sends.in_cycles:
        _require_run(skin, source, is_recording=is_forces)
        made = _of_steps(skin, source, channel, make_imager(skin, solver, gains), every=solver is not None)
        about = {"solver": "steps", "settings": {}}
    else:
        settings = options.settings()
        # A recording of forces has one frame for each cycle.
        has_sums = is_forces and array is None and SUMS in array_names(source)
        of_boards = has_sums or not is_forces
        solve = _solver(skin, options, None if gains is None else load_gains(gains, skin), of_boards=of_boards)
        if has_sums:
            cycles = read_sums(skin, source)
        else:
            cycles = _measured(skin, source, array, full_scale) if is_forces else _logged(skin, source, channel)
        is_run = is_recording(source)
        if calibrator is None and calibration is None and is_run:
            cycles = _as_live(skin, source, cycles)
        if calibrator is not None:
            cycles = _calibrated(skin, cycles, calibrator)
        say("rebuild", f"solver {options.solver}, {settings.iterations} iterations, on the {options.device}")
        made = _Rebuilt(_solved(skin, solve, cycles), cycles.valid, cycles.time_ns, cycles.cycle)
        if is_run and solver is None:
            _compare(skin, source, made)
    if solver is not None or skin.sends.in_cycles:
        about = {"solver": options.solver, "settings": asdict(options.settings())}
    metadata = {
        "format": "canskin images 1",
        "version": version("canskin"),
        "source": source.name,
        "layout": skin.name,
        "fingerprint": skin.operator().fingerprint,
        **about,
        "noise_n": options.noise_n,
        "device": options.device,
    }
    if is_recording(source):
        made = _numbered(skin, source, made)
    arrays: dict[str, Any] = made._asdict() | {"recording": np.array(recording_id(source))}
    with reasoned(RunError, f"{out}: the images cannot be written"), replacing(out) as file:
        np.savez(file, **arrays, metadata=np.array(msgspec.json.encode(metadata).decode()))
    say("rebuild", f"{len(made.images)} images written to {out}")


class _Rebuilt(NamedTuple):
    """The arrays of the file."""

    images: Images
    valid: Bools
    time_ns: Numbers
    cycle: Numbers


def _require_run(skin: Layout, source: Path, *, is_recording: bool) -> None:
    """Refuse what steps are not made from: they follow from what boards send over time."""
    if is_recording:
        what = f"{source}: a recording of forces or of sums in cycles is"
        require_sending(skin, "synchronous", what, "play it with 'skin demo --input', and record that")


def _of_steps(skin: Layout, source: Path, channel: list[str] | None, imager: Imager, *, every: bool) -> _Rebuilt:
    """Make the images of steps, those that the run has shown or of `every` measurement, of its frames."""
    contract = Contract.from_layout(skin)
    offset_ns = wall_offset_ns(source) if is_recording(source) else 0
    made: list[tuple[Images, Bools, int, int]] = []
    compared = equal = 0
    imager.warm_up()
    say("rebuild", f"solver {imager.about}")
    with progress("solving", None) as bar:
        for step in steps_of(source, contract, channel, every=every, service="rebuild"):
            if not isinstance(step, MeasurementStep) or not step.makes_image:
                continue
            sums: Any = imager.decode(step.measurement, contract.phi)
            image, _ = imager.solve(sums)
            at_ns = step.measurement.sampled_mono_ns + offset_ns
            made.append((image, sums.valid, at_ns, step.measurement.cycle))
            if step.image is not None and not every:
                compared += 1
                pixels = image.astype("<f4", copy=False).tobytes()
                equal += same_pixels(pixels, step.image.pixels, skin.taxels.force_max_n)
            bar.advance(1)
    if not any(valid.any() for _, valid, _, _ in made):
        raise RunError(f"{source}: no block is complete in any measurement: is this the skin's layout?")
    _tell(equal, compared)
    images, valid, time_ns, cycle = zip(*made, strict=True)
    numbers = np.array(time_ns, np.int64), np.array(cycle, np.int64)
    return _Rebuilt(np.stack(images), np.stack(valid), *numbers)


def _numbered(skin: Layout, source: Path, made: _Rebuilt) -> _Rebuilt:
    """Give the cycles of a run the numbers and times of its measurements, as `skin export` has them.

    A cycle whose measurement was not recorded has the number -1.
    """
    clocks = recorded_clocks(source)
    if not clocks:
        return made
    at_ns, number = np.array([(each.sampled_mono_ns, each.cycle) for each in clocks], np.int64).T
    told_ns = recorded_wall_times(source, clocks).times_ns(at_ns.tolist())
    place, is_near = nearest(at_ns, made.time_ns - wall_offset_ns(source), 0.5e9 * skin.sync.period_s)
    is_told = is_near & (told_ns[place] >= 0)
    time_ns, cycle = np.where(is_told, told_ns[place], made.time_ns), np.where(is_told, number[place], -1)
    return made._replace(time_ns=time_ns, cycle=cycle)


def _compare(skin: Layout, source: Path, made: _Rebuilt) -> None:
    """Tell how many images of a run are those that it has shown."""
    mono_ns, near_ns = made.time_ns - wall_offset_ns(source), round(0.5e9 * skin.sync.period_s)
    compared = equal = 0
    for _, _, shown in read_messages(source, [IMAGE], lambda _: None):
        place, is_near = nearest(mono_ns, np.array(shown.sampled_mono_ns), near_ns)
        if is_near:
            compared += 1
            pixels = made.images[place].astype("<f4", copy=False).tobytes()
            equal += same_pixels(pixels, shown.pixels, skin.taxels.force_max_n)
    _tell(equal, compared)


def _tell(equal: int, compared: int) -> None:
    if compared:
        why = "" if equal == compared else ": others may follow from images of before the recording, or left out live"
        say("rebuild", f"{equal} of {compared} images equal to the recorded{why}")


def _as_live(skin: Layout, source: Path, cycles: Cycles) -> Cycles:
    """Take off what the live gateway took off."""
    recorded = RecordedOffsets(source, skin)
    if recorded.is_empty:
        return cycles
    found = _calibrated(skin, cycles, recorded)
    say("rebuild", f"offsets of the run are taken off {recorded.applied} of {len(cycles.valid)} cycles")
    return found


def _calibrated(skin: Layout, cycles: Cycles, source: OffsetSource) -> Cycles:
    counts, valid, valid_sums = calibrated_cycles(skin, cycles.counts, cycles.valid_sums, cycles.time_ns, source)
    return replace(cycles, counts=counts, valid=valid, valid_sums=valid_sums)


def _is_recording(source: Path) -> bool:
    """Tell a recording of forces from a CAN log."""
    if not source.is_file():
        raise InputError(f"no file '{source}': expected a CAN log, or a recording as .npz, .npy or .csv")
    suffix = source.suffix.lower()
    if suffix != ".csv":
        return suffix in {".npz", ".npy"}
    with reasoned(InputError, f"{source}: cannot be read"), source.open("rb") as file:
        return file.read(len(_CAN_CSV)) != _CAN_CSV


def _check_options(
    is_recording: bool, channel: list[str] | None, array: list[str] | None, full_scale: float | None
) -> None:
    if is_recording and channel:
        raise InputError("a recording has no CAN channels: leave out --channel")
    if not is_recording and (array or full_scale is not None):
        raise InputError("a CAN log has neither arrays nor a full scale: leave out --array and --full-scale")


def _measured(skin: Layout, source: Path, array: list[str] | None, full_scale: float | None) -> Cycles:
    with progress(f"measuring {source.name}", None) as bar:
        cycles = measure_forces(skin, source, array, full_scale, bar.advance)
    say("rebuild", f"{len(cycles.valid)} frames of {source.name} measured")
    return cycles


def _logged(skin: Layout, source: Path, channel: list[str] | None) -> Cycles:
    """Read and decode a log; of a recording without frames read the measurements."""
    contract, warn = Contract.from_layout(skin), partial(say, "rebuild")
    with progress(f"reading {source.name}", None) as bar:
        if is_recording(source) and not has_frames(read_topics(source)):
            cycles, counted = recorded_cycles(contract, source, warn), "recorded measurements, without frames"
        else:
            logged = frames_of_log(skin, source, channel, warn)
            cycles, counts = decode_log(contract, logged, bar.advance)
            counted = _counted(counts)
    if not cycles.valid.any():
        raise RunError(f"{source}: no block of any cycle is complete ({counted}): is this the skin's layout?")
    complete = int(cycles.valid[:, contract.phi.has_sums].all(axis=1).sum())
    say("rebuild", f"{complete} of {len(cycles.valid)} cycles are complete: {counted}")
    return cycles


def _counted(counts: FrameCounts) -> str:
    """Return the frame counts as text, with the names of the gateway's counters."""
    words = ("accepted", "missing", "late", "duplicate", "malformed", "foreign")
    return "frames " + ", ".join(f"{getattr(counts, word)} {word}" for word in words)


def _solver(skin: Layout, options: SolverOptions, gains: KnownGains | None, *, of_boards: bool) -> _Solve:
    """Return what makes the images of all cycles: of sums `of_boards`, or of one instant that are no averages."""
    settings, noise_n, library = options.settings(), options.clipped_noise_n(skin), options.library()

    def solve(sums_n: Sums, valid: Bools, cycle: Numbers, advance: Callable[[int], None]) -> Images:
        return reconstruct(
            sums_n,
            skin.operator(),
            skin.taxels.surface,
            settings,
            valid_sums=valid,
            cycles=cycle,
            noise_n=noise_n,
            samples=skin.samples_per_sync if of_boards else 1,
            turns=skin.sync.turns if of_boards else 1,
            gains=gains,
            library=library,
            advance=advance,
        )

    return solve


def _solved(skin: Layout, solve: _Solve, cycles: Cycles) -> Images:
    """Return the images, and log the time."""
    sums_n = np.multiply(cycles.counts, np.float32(skin.taxels.newton_per_count), dtype=np.float32)
    valid = cycles.valid_sums
    solve(sums_n[:1], valid[:1], cycles.cycle[:1], lambda _: None)  # compiles the solver, or loads the compiled solver
    started_s = time.perf_counter()
    with progress("solving", len(sums_n)) as bar:
        images = solve(sums_n, valid, cycles.cycle, bar.advance)
    elapsed_s = time.perf_counter() - started_s
    say("rebuild", f"{len(images)} images in {elapsed_s:.2f} s: {len(images) / elapsed_s:.0f} images/s")
    return images
