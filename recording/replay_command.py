"""``skin replay``: a recorded run through gateway, reconstructor and classifier."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from bus.options import Channels
from calibration.calibrator import Tare
from canskin.errors import InputError, RunError
from canskin.fabric import Exchange
from canskin.session import DEFAULT_ENDPOINT
from classifier.cache import find_or_train
from classifier.decide import Classifier
from classifier.modelfile import load_model
from classifier.service import ClassifierService, SteppedClassifierService, make_service
from classifier.used_sums import classified_phi
from dbc.contract import Contract
from reconstructor.options import SolverOptions
from recording import RECORDING_SUFFIX, file_of, is_recording
from recording.image_arrays import ImageArrays
from recording.mcap_file import CALIBRATION_FILE, File, newest_file, recording_id
from recording.replay_folder import ARRAYS, Run, Settings, replay_folder
from recording.replaying import Replay
from recording.sinks import McapSink
from shell.output import check_new_path
from shell.parallel import Cluster
from shell.service import StopSignal, say
from shell.skin_options import Insecure, check_listen, join
from skin.layout import Layout
from skin.sources import DEFAULT_OBJECTS


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
    jobs: int | None = None,
    cluster: Cluster = None,
) -> None:
    """Play a recording or a CAN log through gateway, reconstructor and classifier, on a hub or into a new file.

    Images, contacts and labels are made from the recorded measurements, one after the other in one process: the same
    file always gives the same. The end of the log tells how many images and labels are equal to the recorded ones. The
    gateway's loop makes the measurements of frames alone; there every node counts as proven.

    Of a folder each recording gives a file of images in another folder, whose manifest.json tells of each its digest
    and what came of it. A second run makes what is missing: new and changed recordings, and those that gave an error.

    Parameters
    ----------
    source
        A recording (.mcap), or a log of candump (-l), ASC, BLF or any other format that python-can reads; or a folder
        of recordings.
    layout
        TOML of the skin; default: the layout in the recording, for a log the default skin.
    skin_
        Name of the skin, where the recording has several.
    speed
        2 plays twice as fast as the run, inf as fast as possible. Default: 1 on a hub, inf into a file.
    out
        New file in place of a hub: a recording (.mcap), or the images alone (.npz): ``images`` float32 (n, rows,
        columns) in newtons, ``valid`` bool (n, blocks), ``time_ns`` and ``cycle`` int64 (n,), ``recording``,
        ``metadata`` JSON. Of a folder: a folder for such files.
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
    jobs
        Of a folder: recordings at the same time. Default: one per core.
    cluster
        In place of `jobs`.

    Examples
    --------
    skin replay run.mcap & skin view
    skin replay candump-2026-11-20_120000.log --out run.mcap
    skin replay run.mcap --out images.npz --solver paper
    skin replay recordings --out images --cluster tcp/10.0.0.5:8786
    """
    settings = Settings(layout, skin_, solver, calibration, tare, gains)
    if source.is_dir():
        _replay_all(source, out, settings, cluster or jobs, (speed, listen, channel, model))
        return
    _check(source, speed, out, cluster or jobs)
    check_listen(listen or DEFAULT_ENDPOINT, insecure=insecure)
    stop = StopSignal().install()
    run = Run(source, settings, channel)
    source, skin, offset_ns = run.source, run.skin, run.offset_ns
    arrays = ImageArrays(offset_ns) if _is_of_arrays(out) else None
    # Images alone need no labels, but programs on a hub do.
    make_classifier = _classifier(skin, model) if arrays is None or listen is not None else None
    sink = _open(out, source, run.contract, offset_ns) if out is not None and arrays is None else None
    fabric = join(skin, "replay", listen or DEFAULT_ENDPOINT, hub=True) if out is None or listen is not None else None
    say("replay", f"{source.name}: {run.imager.about}")
    receivers = [each.publish for each in (fabric, arrays) if each is not None]
    played = Replay(skin, run.imager, make_classifier, receivers=receivers, sink=sink, offset_ns=offset_ns)
    try:
        played.run(run.steps, stop, speed or (1.0 if fabric else float("inf")))
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
        arrays.save(out, skin, recording_id(source), settings.about(source, skin))


def _replay_all(
    folder: Path, out: Path | None, settings: Settings, jobs: int | str | None, others: tuple[object, ...]
) -> None:
    if out is None or any(each is not None for each in others):
        raise InputError(f"{folder} is a folder: expected --out FOLDER, and no --speed, --listen, --channel, --model")
    replay_folder(folder, out, settings, (os.cpu_count() or 1) if jobs is None else jobs)


def _check(source: Path, speed: float | None, out: Path | None, jobs: int | str | None) -> None:
    """Check the options that need no file to be read."""
    if jobs is not None:
        raise InputError(f"--jobs and --cluster are for a folder of recordings, got {source}")
    if speed is not None and not speed > 0:
        raise InputError(f"--speed: expected a number above 0, or inf, got {speed:g}")
    if out is not None:
        if not (is_recording(out) or _is_of_arrays(out)):
            raise InputError(f"{out}: expected a name that ends in {RECORDING_SUFFIX}, or in {ARRAYS} for images alone")
        check_new_path(out, "replay")
    if not file_of(source).is_file():
        raise InputError(f"no file '{source}': expected a recording of 'skin record', or a CAN log")


def _is_of_arrays(out: Path | None) -> bool:
    return out is not None and out.suffix.lower() == ARRAYS


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
