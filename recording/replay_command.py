"""``skin replay``: a recorded run through gateway, reconstructor and classifier."""

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from bus.options import Channels
from calibration.calibrator import Tare
from calibration.offline import make_calibrator
from canskin.errors import InputError, RunError
from canskin.fabric import Exchange
from canskin.session import DEFAULT_ENDPOINT
from classifier.cache import find_or_train
from classifier.decide import Classifier
from classifier.modelfile import load_model
from classifier.service import ClassifierService, SteppedClassifierService, make_service
from classifier.used_sums import classified_phi
from dbc.contract import Contract
from reconstructor.imaging import make_imager
from reconstructor.options import SolverOptions
from reconstructor.service import warm_up
from recording import RECORDING_SUFFIX, file_of, is_recording
from recording.image_arrays import ImageArrays
from recording.mcap_file import CALIBRATION_FILE, File, newest_file, part_of, recording_id, wall_offset_ns
from recording.replaying import Replay
from recording.run_steps import steps_of
from recording.sinks import McapSink
from shell.output import check_new_path
from shell.service import StopSignal, say
from shell.skin_options import Insecure, check_listen, join
from skin.layout import Layout, load_layout
from skin.sources import DEFAULT_OBJECTS

#: Ends the name of a file of images alone.
_ARRAYS: Final = ".npz"


def replay(
    source: Path,
    *,
    layout: Path | None = None,
    skin_: str | None = None,
    speed: float | None = None,
    out: Path | None = None,
    listen: str | None = None,
    insecure: Insecure = False,
    channel: Channels | None = None,
    solver: SolverOptions | None = None,
    model: Path | None = None,
    calibration: Path | None = None,
    tare: Tare = "never",
    gains: Path | None = None,
) -> None:
    """Play a recording or a CAN log through gateway, reconstructor and classifier, on a hub or into a new file.

    Images, contacts and labels are made from the recorded measurements, one after the other in one process: the same
    file always gives the same. The end of the log tells how many images and labels are equal to the recorded ones. The
    gateway's loop makes the measurements of frames alone; there every node counts as proven.

    Parameters
    ----------
    source
        A recording (.mcap), or a log of candump (-l), ASC, BLF or any other format that python-can reads.
    layout
        TOML of the skin; default: the layout in the recording, for a log the default skin.
    skin_
        Name of the skin, where the recording has several.
    speed
        2 plays twice as fast as the run, inf as fast as possible. Default: 1 on a hub, inf into a file.
    out
        New file in place of a hub: a recording (.mcap), or the images alone (.npz): ``images`` float32 (n, rows,
        columns) in newtons, ``valid`` bool (n, blocks), ``time_ns`` and ``cycle`` int64 (n,), ``recording``,
        ``metadata`` JSON.
    listen
        Endpoint of the hub; services connect to it as to the gateway. Default: that of ``skin gateway``.
    insecure
        See ``skin gateway``.
    channel
        Channels of a log, one per bus. Default: the names of the buses, else all channels in their order.
    solver
        Solver of the images; with it every measurement makes an image, not those alone that made one in the run.
    model
        Model of the classifier; default: as ``skin classify``.
    calibration
        Of frames alone: file of ``skin calibration save``, or a recording, whose newest offsets are taken off.
    tare
        Of frames alone, ``at-start``: measure the offsets as the gateway does, and follow them.
    gains
        As of ``skin reconstruct``.

    Examples
    --------
    skin replay run.mcap & skin view
    skin replay candump-2026-11-20_120000.log --out run.mcap
    skin replay run.mcap --out images.npz --solver paper
    """
    _check(source, speed, out)
    source = part_of(source, skin_)
    check_listen(listen or DEFAULT_ENDPOINT, insecure=insecure)
    stop = StopSignal().install()
    skin = load_layout(source if is_recording(source) and layout is None else layout)
    if channel and is_recording(source):
        raise InputError("--channel is for logs: a recording names its buses; leave it out")
    contract = Contract.from_layout(skin)
    offset_ns = wall_offset_ns(source) if is_recording(source) else 0
    calibrator = make_calibrator(skin, calibration, tare, "replay")
    imager = make_imager(skin, solver, gains)
    warm_up(skin, imager)
    steps = steps_of(source, contract, channel, every=solver is not None, calibrator=calibrator)
    arrays = ImageArrays(offset_ns) if _is_of_arrays(out) else None
    # Images alone need no labels, but programs on a hub do.
    make_classifier = _classifier(skin, model) if arrays is None or listen is not None else None
    sink = _open(out, source, contract, offset_ns) if out is not None and arrays is None else None
    fabric = join(skin, "replay", listen or DEFAULT_ENDPOINT, hub=True) if out is None or listen is not None else None
    say("replay", f"{source.name}: {imager.about}")
    receivers = [each.publish for each in (fabric, arrays) if each is not None]
    played = Replay(skin, imager, make_classifier, receivers=receivers, sink=sink, offset_ns=offset_ns)
    try:
        played.run(steps, stop, speed or (1.0 if fabric else float("inf")))
        if sink is not None:
            sink.close()
    except OSError as error:
        raise RunError(f"{out}: the recording ends: {error.strerror or error}") from error
    finally:
        if sink is not None and out is not None:
            sink.abandon()
            if not played.report.measured:
                out.unlink(missing_ok=True)
        if fabric is not None:
            fabric.close()
    for line in played.report.lines():
        say("replay", line)
    if not played.report.measured and not stop.is_set():
        raise RunError(
            f"{source}: gave no measurement with a valid block: is this the skin's layout? Of a skin that sends"
            " steps, a log must hold the start or a request of the gateway"
        )
    if arrays is not None and out is not None and played.report.measured:
        arrays.save(out, skin, recording_id(source), _about(source, skin, solver))


def _check(source: Path, speed: float | None, out: Path | None) -> None:
    """Check the options that need no file to be read."""
    if speed is not None and not speed > 0:
        raise InputError(f"--speed: expected a number above 0, or inf, got {speed:g}")
    if out is not None:
        if not (is_recording(out) or _is_of_arrays(out)):
            raise InputError(
                f"{out}: expected a name that ends in {RECORDING_SUFFIX}, or in {_ARRAYS} for images alone"
            )
        check_new_path(out, "replay")
    if not file_of(source).is_file():
        raise InputError(f"no file '{source}': expected a recording of 'skin record', or a CAN log")


def _is_of_arrays(out: Path | None) -> bool:
    return out is not None and out.suffix.lower() == _ARRAYS


def _classifier(skin: Layout, model: Path | None) -> Callable[[Exchange], ClassifierService | SteppedClassifierService]:
    """Return what makes the classifier's service."""
    classified = classified_phi(skin)
    trained = load_model(model, skin, classified) if model else find_or_train(skin, classified, DEFAULT_OBJECTS)
    return partial(make_service, Classifier(trained, classified), skin)


def _open(out: Path, source: Path, contract: Contract, offset_ns: int) -> McapSink:
    """Open a new recording. Attachments have no time: the same file gives the same bytes."""
    sink = McapSink(out, contract, 0, offset_ns, recording_id(source))
    recorded = newest_file(source, CALIBRATION_FILE) if is_recording(source) else None
    if recorded is not None:
        sink.attach(File(CALIBRATION_FILE, "application/json", recorded), 0)
    return sink


def _about(source: Path, skin: Layout, given: SolverOptions | None) -> dict[str, Any]:
    """Return what made the images of a file."""
    solver = given or SolverOptions()
    is_solved = given is not None or skin.sends.in_cycles
    return {
        "format": "canskin images 1",
        "version": version("canskin"),
        "source": source.name,
        "solver": solver.solver if is_solved else "steps",
        "settings": asdict(solver.settings()) if is_solved else {},
        "noise_n": solver.noise_n,
    }
