"""``skin record``: a running skin to a file."""

import threading
import time
from functools import partial
from pathlib import Path
from typing import Final

import msgspec

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
from recording.recorder import Recorder
from recording.sinks import check_format, open_sink
from shell.output import check_new_path
from shell.pulse import Pulse
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
    label: str | None = None,
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
        What touches the skin, from the start on. The page and programs set other labels meanwhile, ``skin label``
        corrects labels, ``skin train --recordings`` learns them.
    frames
        ``--no-frames`` opens no bus and records the messages alone, as the page does.

    Examples
    --------
    skin record run.mcap
    skin record cup.mcap --label cup
    skin record run.log --layout palm.toml -i socketcan -c can0 --seconds 60
    """
    if seconds is not None:
        require_above_zero("--seconds", seconds)
    stop, of = StopSignal().install(), of or SkinOptions()
    pulse = Pulse(stop)
    check_new_path(out, "recording")
    check_format(out)
    name = None if label is None else check_label(label.strip())
    _check_kept(out, "--label", name is not None)
    _check_kept(out, "--no-frames", not frames)
    skin = of.find("recorder", stop)
    if of.layout is not None:
        of.compare(skin)
    check_format(out, skin)
    contract = Contract.from_layout(skin)
    names = {number: each.name for number, each in enumerate(skin.bus)}
    opened = range(len(skin.bus) if frames else 0)
    links = open_links(skin, bus or BusOptions(), opened, name="recorder", sends=False, stop=stop)
    joining: threading.Thread | None = None
    try:
        now_ns = time.time_ns()
        sink = open_sink(out, contract, now_ns, now_ns - time.monotonic_ns())
        recorder = Recorder(links, sink, names)
        if name:
            say("record", f"label: {name}")
            recorder.take_message(MARK, msgspec.msgpack.encode(Mark(label=name)))
        join = partial(_join, of, skin, recorder, stop, pulse)
        if sink.has_messages:  # a program that sets marks is to see no recorder that cannot write them
            joining = threading.Thread(target=join, name="join the fabric")
            joining.start()
        say("record", f"{', '.join(names.values()) if frames else 'messages'} to {out}")
        request_real_time("record")  # else services with it keep messages from coming
        recorder.run(stop, seconds or float("inf"), pulse.beat)
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
        if pulse.fabric is not None:
            pulse.fabric.close()
    _conclude(recorder, out)


def _check_kept(out: Path, option: str, is_given: bool) -> None:
    """Check that a file keeps the messages that an option is about."""
    if is_given and not is_recording(out):
        raise InputError(f"{option}: expected a recording that ends in {RECORDING_SUFFIX}: {out} keeps frames alone")


def _join(of: SkinOptions, skin: Layout, recorder: Recorder, stop: StopSignal, pulse: Pulse) -> None:
    """Subscribe to everything when there is a hub; frames are recorded meanwhile."""

    def note(peer: Peer, alive: bool) -> None:
        if peer.skin == skin.name:
            recorder.take_event(peer.service, f"{'is there' if alive else 'has left'}, version {peer.version}")

    def subscribe(fabric: Fabric) -> None:  # before a program sees the recorder, and sends it marks
        fabric.watch_peers(note)
        for topic in TOPICS:
            fabric.subscribe_bytes(topic, partial(recorder.take_message, topic))

    try:
        fabric = pulse.fabric = of.join(skin, "recorder", stop, prepare=subscribe)
    except Stopped:
        return
    except (BusError, LayoutError) as error:
        say("record", f"frames alone: {error}")
        return
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
    if recorder.left_out:
        say(
            "record", f"{recorder.left_out} error, remote or CAN FD frames are missing: {out.suffix} does not hold them"
        )
    if recorder.lost:
        say("record", f"{recorder.lost} frames or messages came too fast for this machine and are missing")
