"""``skin record``: a running skin to a file."""

import threading
import time
from functools import partial
from pathlib import Path
from typing import Annotated, Final

import msgspec
from cyclopts import Parameter

from bus.options import BusOptions, open_links
from calibration.attachment import follow_calibration
from canskin.errors import BusError, InputError, LayoutError, RunError, Stopped
from canskin.fabric import Fabric
from canskin.messages import (
    CONTACTS,
    GATEWAY,
    IMAGE,
    LABEL,
    MARK,
    MEASUREMENT,
    NODES,
    TRUTH,
    Mark,
    check_label,
)
from canskin.peers import Peer
from dbc.contract import Contract
from recording import RECORDING_SUFFIX, is_recording
from recording.mark_keys import KEYS, has_keys, mark_keys
from recording.recorder import Recorder
from recording.sinks import check_format, open_sink
from shell.output import check_new_path
from shell.service import StopSignal, request_real_time, say
from shell.skin_options import SkinOptions
from skin.layout import Layout
from skin.ranges import require_above_zero

TOPICS: Final = (MEASUREMENT, IMAGE, CONTACTS, LABEL, GATEWAY, NODES, TRUTH, MARK)


def record(
    out: Path,
    *,
    of: SkinOptions | None = None,
    bus: BusOptions | None = None,
    seconds: float | None = None,
    label: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=1)] = None,
    frames: bool = True,
) -> None:
    """Record a running skin: the frames of its buses, measurements, images, contacts, labels, truth and counters.

    The recorder sends nothing on the buses. With ``--layout`` it needs no other service: frames are recorded from the
    start, messages as soon as there is a hub. After a crash or on a full disk the file is readable up to its last
    second.

    Parameters
    ----------
    out
        New file: .mcap, with the layout and the contract files attached; or frames alone, in the format of python-can
        that the suffix names: .log (candump), .asc, .blf, .trc, .mf4, .txt, and .csv and .db of a single bus.
    of
        Which skin.
    bus
        CAN interface and channels, as the gateway's.
    seconds
        Time to record; default: until a stop signal.
    label
        What touches the skin, with commas between several. A single label holds from the start on. On a terminal the
        keys 1 to 9 set the first to the ninth label, and 0 or the space bar ends it. ``skin label`` corrects labels,
        ``skin train --recordings`` learns them.
    frames
        ``--no-frames`` opens no bus and records the messages alone, as the page does.

    Examples
    --------
    skin record run.mcap
    skin record cup.mcap --label cup
    skin record many.mcap --label cup,ball,pen
    skin record run.log --layout palm.toml -i socketcan -c can0 --seconds 60
    """
    if seconds is not None:
        require_above_zero("--seconds", seconds)
    stop, of = StopSignal().install(), of or SkinOptions()
    check_new_path(out, "recording")
    labels = _labels(label or [], out)
    if not frames and not is_recording(out):
        raise InputError(f"--no-frames: expected a recording that ends in {RECORDING_SUFFIX}: {out} keeps frames alone")
    skin = of.find(stop)
    if of.layout is not None:
        of.compare(skin)
    check_format(out, len(skin.bus))
    contract = Contract.from_layout(skin)
    names = {number: each.name for number, each in enumerate(skin.bus)}
    opened = range(len(skin.bus) if frames else 0)
    links = open_links(skin, bus or BusOptions(), opened, name="recorder", sends=False, stop=stop)
    joined: list[Fabric] = []
    joining: threading.Thread | None = None
    try:
        now_ns = time.time_ns()
        sink = open_sink(out, contract, now_ns, now_ns - time.monotonic_ns())
        recorder = Recorder(links, sink, names)
        if len(labels) == 1:
            _mark(recorder, labels[0])
        join = partial(_join, of, skin, recorder, stop, joined)
        if sink.has_messages:  # a program that sets marks is to see no recorder that cannot write them
            joining = threading.Thread(target=join, name="join the fabric")
            joining.start()
        say("record", f"{', '.join(names.values()) if frames else 'messages'} to {out}")
        request_real_time("record")  # else services with it keep messages from coming
        with mark_keys(labels, partial(_mark, recorder)) as poll:
            recorder.run(stop, seconds or float("inf"), poll)
    except OSError as error:
        reason = error.strerror or error
        raise RunError(f"{out}: the recording ends: {reason}; what was written before is readable") from error
    finally:
        stop.set()
        for link in links.values():
            link.close()
        if joining is not None:
            # A thread that returns from zenoh while the interpreter ends would abort the process.
            joining.join()
        for fabric in joined:
            fabric.close()
    _conclude(recorder, out)


def _labels(given: list[str], out: Path) -> list[str]:
    """Return the labels of the keys, checked."""
    labels = [check_label(each.strip()) for text in given for each in text.split(",") if each.strip()]
    if labels and not is_recording(out):
        raise InputError(f"--label: expected a recording that ends in {RECORDING_SUFFIX}: {out} keeps frames alone")
    if len(labels) > len(KEYS):
        raise InputError(f"--label: expected up to {len(KEYS)} labels, a key for each, got {len(labels)}")
    if len(labels) > 1 and not has_keys():
        raise InputError("--label: several labels are set by keys, and there is no terminal: give one label")
    if labels and has_keys():
        keys = ", ".join(f"{key} {each}" for key, each in zip(KEYS, labels, strict=False))
        say("record", f"keys: {keys}, 0 or space: no label")
    return labels


def _mark(recorder: Recorder, label: str) -> None:
    say("record", f"label: {label or 'none'}")
    recorder.take_message(MARK, msgspec.msgpack.encode(Mark(label=label)))


def _join(of: SkinOptions, skin: Layout, recorder: Recorder, stop: StopSignal, joined: list[Fabric]) -> None:
    """Subscribe to everything when there is a hub; frames are recorded meanwhile."""

    def note(peer: Peer, alive: bool) -> None:
        if peer.skin == skin.name:
            recorder.take_event(peer.service, f"{'is there' if alive else 'has left'}, version {peer.version}")

    def subscribe(fabric: Fabric) -> None:  # before a program sees the recorder, and sends it marks
        fabric.watch_peers(note)
        for topic in TOPICS:
            fabric.subscribe_bytes(topic, partial(recorder.take_message, topic))

    try:
        fabric = of.join(skin, "recorder", stop, prepare=subscribe)
    except Stopped:
        return
    except (BusError, LayoutError) as error:
        say("record", f"frames alone: {error}")
        return
    joined.append(fabric)
    follow_calibration(fabric, recorder.take_file, stop)


def _conclude(recorder: Recorder, out: Path) -> None:
    """Log what was recorded."""
    if not recorder.frames + recorder.messages:
        raise RunError(f"{out}: nothing came: no frame and no message. Are buses and services those of this layout?")
    size_mb = out.stat().st_size / 1e6
    say("record", f"{recorder.frames} frames and {recorder.messages} messages in {out}, {size_mb:.1f} MB")
    missed = ", ".join(f"{count} {topic}" for topic, count in recorder.missed.counts().items())
    if missed and recorder.messages:
        say("record", f"messages that never came, because the fabric drops them on a busy machine: {missed}")
    if recorder.lost:
        say("record", f"{recorder.lost} frames or messages came too fast for this machine and are missing")
