"""``skin replay``: a recorded run through gateway, reconstructor and classifier."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from bus.options import Channels
from calibration.calibrator import Tare
from calibration.offline import make_calibrator
from canskin.description import DESCRIPTION
from canskin.errors import InputError, RunError
from canskin.fabric import Fabric
from canskin.session import DEFAULT_ENDPOINT
from classifier.cache import find_or_train
from classifier.decide import Classifier
from classifier.modelfile import load_model
from classifier.service import make_service
from classifier.used_sums import classified_phi
from dbc.contract import Contract
from reconstructor.imaging import make_imager
from reconstructor.options import SolverOptions
from reconstructor.service import warm_up
from recording import RECORDING_SUFFIX, is_recording
from recording.mcap_file import CALIBRATION_FILE, File, newest_file, recording_id, wall_offset_ns
from recording.replaying import Replay
from recording.sinks import McapSink
from recording.step_kinds import Step
from recording.steps import steps_of
from shell.output import check_new_path
from shell.service import StopSignal, say
from shell.skin_options import join
from skin.description import describe
from skin.layout import load_layout
from skin.sources import DEFAULT_OBJECTS


def replay(
    source: Path,
    *,
    layout: Path | None = None,
    speed: float | None = None,
    out: Path | None = None,
    listen: str | None = None,
    channel: Channels | None = None,
    solver: SolverOptions | None = None,
    model: Path | None = None,
    calibration: Path | None = None,
    tare: Tare = "never",
    gains: Path | None = None,
) -> None:
    """Play a recording or a CAN log through gateway, reconstructor and classifier, on a hub or into a new recording.

    Sums are decoded from the frames by the gateway's loop, and images, contacts and labels are made from the sums, one
    after the other in one process: the same file always gives the same. With a recording of ``skin record`` numbers,
    times and proofs of nodes are the recorded ones, and the end of the log tells how many measurements, images and
    labels are equal to the recorded ones. In a log every node counts as proven.

    Parameters
    ----------
    source
        A recording (.mcap), or a log of candump (-l), ASC, BLF or any other format that python-can reads.
    layout
        TOML of the skin; default: the layout in the recording, for a log the default skin.
    speed
        2 plays twice as fast as the run, inf as fast as possible. Default: 1 on a hub, inf into a file.
    out
        New recording (.mcap) in place of a hub.
    listen
        Endpoint of the hub; services connect to it as to the gateway. Default: that of ``skin gateway``.
    channel
        Channels of a log, one per bus. Default: the names of the buses, else all channels in their order.
    solver
        Solver of the images.
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
    skin replay candump-2026-11-20_120000.log --speed inf --out run.mcap
    """
    _check(source, speed, out)
    stop = StopSignal().install()
    skin = load_layout(source if is_recording(source) and layout is None else layout)
    if channel and is_recording(source):
        raise InputError("--channel is for logs: a recording names its buses; leave it out")
    contract = Contract.from_layout(skin)
    offset_ns = wall_offset_ns(source) if is_recording(source) else 0
    calibrator = make_calibrator(skin, calibration, tare, "replay")
    imager = make_imager(skin, solver, gains)
    warm_up(skin, imager)
    classified = classified_phi(skin)
    trained = load_model(model, skin, classified) if model else find_or_train(skin, classified, DEFAULT_OBJECTS)
    steps = steps_of(source, contract, channel, every=solver is not None, calibrator=calibrator)
    # Attachments have no time: the same file gives the same bytes.
    sink = McapSink(out, contract, 0, offset_ns, recording_id(source)) if out is not None else None
    recorded = newest_file(source, CALIBRATION_FILE) if is_recording(source) else None
    if sink is not None and recorded is not None:
        sink.attach(File(CALIBRATION_FILE, "application/json", recorded), 0)
    fabric = None
    if out is None or listen is not None:
        fabric = join(skin, "replay", listen or DEFAULT_ENDPOINT, hub=True)
        about = describe(skin)
        fabric.answer(DESCRIPTION, lambda _request, reply: reply(about))
    say("replay", f"{source.name}: {imager.about}")
    make_classifier = partial(make_service, Classifier(trained, classified), skin)
    played = Replay(skin, imager, make_classifier, fabric=fabric, sink=sink, offset_ns=offset_ns)
    _run(played, steps, stop, speed or (1.0 if fabric else float("inf")), sink, fabric, out)
    for line in played.report.lines():
        say("replay", line)
    if not played.report.measurements.made and not stop.is_set():
        raise RunError(f"{source}: gave no measurement: is this the skin's layout?")


def _run(  # noqa: PLR0917 - parts of one replay
    played: Replay,
    steps: Iterator[Step],
    stop: StopSignal,
    speed: float,
    sink: McapSink | None,
    fabric: Fabric | None,
    out: Path | None,
) -> None:
    """Play all, and close what was opened; a new recording without any measurement is deleted."""
    try:
        played.run(steps, stop, speed)
        if sink is not None:
            sink.close()
    except OSError as error:
        raise RunError(f"{out}: the recording ends: {error.strerror or error}") from error
    finally:
        if sink is not None:
            sink.abandon()
        if out is not None and not played.report.measurements.made:
            out.unlink(missing_ok=True)
        if fabric is not None:
            fabric.close()


def _check(source: Path, speed: float | None, out: Path | None) -> None:
    """Check the options that need no file to be read."""
    if speed is not None and not speed > 0:
        raise InputError(f"--speed: expected a number above 0, or inf, got {speed:g}")
    if out is not None:
        check_new_path(out, "recording", RECORDING_SUFFIX)
    if not source.is_file():
        raise InputError(f"no file '{source}': expected a recording of 'skin record', or a CAN log")
