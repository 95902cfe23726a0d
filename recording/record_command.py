"""``skin record``: a running skin to a file."""

import threading
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partial
from itertools import islice
from math import inf
from pathlib import Path
from typing import Final

import msgspec

from bus.link import Link
from bus.options import BusOptions, channels, closing_links, open_links
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
from recording.recorder import Recorder, run
from recording.sinks import Sink, check_format, open_sinks
from shell.output import check_new_path
from shell.pulse import Pulse
from shell.service import StopSignal, request_real_time, say
from shell.skin_options import SkinOptions, hub_layout, knows_layout
from skin.difference import difference
from skin.layout import Layout, changed
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
    start, messages as soon as there is a hub. All skins that the hub has then are recorded into one file. After a crash
    or on a full disk the file is readable up to its last second.

    Parameters
    ----------
    out
        New file: .mcap, with the layout and the contract files attached; or frames alone, in the format of python-can
        that the suffix names: .log (candump), .asc, .blf, .trc, .mf4, .txt, and .csv and .db of a single bus.
    of
        Which skin; default: all on the hub.
    bus
        CAN interface and channels, as the gateway's; of several skins the channels of one after the other, by name.
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
    stop, of, bus = StopSignal().install(), of or SkinOptions(), bus or BusOptions()
    check_new_path(out, "recording")
    check_format(out)
    name = None if label is None else check_label(label.strip())
    _check_kept(out, "--label", name is not None)
    _check_kept(out, "--no-frames", not frames)
    skins = of.find_all("recorder", stop)
    if of.layout is not None:
        of.compare(skins[0])
    _check_kept(out, f"the {len(skins)} skins on the hub, without --skin NAME", len(skins) > 1)
    for skin in skins:
        check_format(out, skin)
    parts: list[_Part] = []
    try:
        with ExitStack() as closes:
            opened = [closes.enter_context(closing_links(each)) for each in _open(skins, bus, stop, frames=frames)]
            sinks = open_sinks(out, [Contract.from_layout(skin) for skin in skins])
            for skin, links, sink in zip(skins, opened, sinks, strict=True):
                parts.append(_Part(skin, links, sink, stop))
                parts[-1].start(of, name)
            carried = ", ".join(bus.name for skin in skins for bus in skin.bus) if frames else "messages"
            of_many = f" of {', '.join(skin.name for skin in skins)}" * (len(skins) > 1)
            say("record", f"{carried}{of_many} to {out}")
            request_real_time("record")  # else services with it keep messages from coming
            run([each.recorder for each in parts], stop, seconds or inf)
    except OSError as error:
        reason = error.strerror or error
        raise RunError(f"{out}: the recording ends: {reason}; what was written before is readable") from error
    finally:
        stop.set()
        for each in parts:
            each.close()
    _conclude([each.recorder for each in parts], out)
    if differs := "; ".join(filter(None, (each.differs for each in parts))):
        raise RunError(f"{out} has ended: the gateway has another layout now: {differs}. Record it in another file")


def _check_kept(out: Path, option: str, is_given: bool) -> None:
    """Check that a file keeps the messages that an option is about."""
    if is_given and not is_recording(out):
        raise InputError(f"{option}: expected a recording that ends in {RECORDING_SUFFIX}: {out} keeps frames alone")


class _Part:
    """What records a skin: its buses and, as soon as there is a hub, what its services send.

    A gateway that comes back with another layout ends the recording: `differs` tells how.
    """

    def __init__(self, skin: Layout, links: dict[int, Link], sink: Sink, stop: StopSignal) -> None:
        self._skin, self._stop, self._pulse = skin, stop, Pulse(stop)
        self._joining: threading.Thread | None = None
        self._started, self.differs = threading.Event(), ""
        names = {number: each.name for number, each in enumerate(skin.bus)}
        self.recorder = Recorder(links, sink, names, beat=self._pulse.beat)

    def start(self, of: SkinOptions, label: str | None) -> None:
        """Write the label that holds from the start, and begin to join the fabric."""
        if label:
            say("record", f"label: {label}")
            self.recorder.take_message(MARK, msgspec.msgpack.encode(Mark(label=label)))
        if self.recorder.sink.has_messages:  # a program that sets marks is to see no recorder that cannot write them
            self._joining = threading.Thread(target=self._join, args=(of,), name="join the fabric")
            self._joining.start()

    def close(self) -> None:
        """Leave the fabric, after `stop` was set."""
        if self._joining is not None:
            # A thread that returns from zenoh while the interpreter ends would abort the process.
            self._joining.join()
        if self._pulse.fabric is not None:
            self._pulse.fabric.close()

    def _join(self, of: SkinOptions) -> None:
        """Subscribe to everything when there is a hub; frames are recorded meanwhile."""
        recorder = self.recorder

        def note(peer: Peer, alive: bool) -> None:
            if peer.skin == self._skin.name:
                recorder.take_event(peer.service, f"{'is there' if alive else 'has left'}, version {peer.version}")
                if alive and knows_layout(peer):
                    self._started.set()

        def subscribe(fabric: Fabric) -> None:  # before a program sees the recorder, and sends it marks
            fabric.watch_peers(note)
            for topic in TOPICS:
                fabric.subscribe_bytes(topic, partial(recorder.take_message, topic))

        try:
            fabric = self._pulse.fabric = of.join(self._skin, "recorder", self._stop, prepare=subscribe)
        except Stopped:
            return
        except (BusError, LayoutError) as error:
            say("record", f"frames alone: {error}")
            return
        fabric.clock()  # what is known of it is among the messages
        follow_calibration(fabric, recorder.take_file, self._stop, partial(self._compare, of.endpoint))

    def _compare(self, endpoint: str) -> None:
        """End the recording if a gateway has come that has another layout."""
        if not self._started.is_set():
            return
        self._started.clear()
        with suppress(BusError, Stopped):  # the gateway has left again
            told = hub_layout(endpoint, self._skin.name, self._stop, service="recorder")
            if differs := difference(msgspec.to_builtins(self._skin), msgspec.to_builtins(told)):
                self.differs = differs
                self.recorder.take_event("record", f"the gateway has another layout now: {differs}")
                self._stop.set()


def _open(skins: Sequence[Layout], bus: BusOptions, stop: StopSignal, *, frames: bool) -> Iterator[dict[int, Link]]:
    """Yield the links of each skin; ``--channel`` names those of all skins, one after the other."""
    lines = [each for skin in skins for each in skin.bus]
    named = iter(channels(changed(skins[0], bus=lines), bus) if frames else [])
    for skin in skins:
        own = replace(bus, channel=[*islice(named, len(skin.bus))])
        opened = range(len(skin.bus) if frames else 0)
        yield open_links(skin, own, opened, name="recorder", sends=False, stop=stop)


def _conclude(recorders: Sequence[Recorder], out: Path) -> None:
    """Log what was recorded."""
    frames, messages = sum(each.frames for each in recorders), sum(each.messages for each in recorders)
    if not frames + messages:
        raise RunError(f"{out}: nothing came: no frame and no message. Are buses and services those of this layout?")
    size_mb = out.stat().st_size / 1e6
    say("record", f"{frames} frames and {messages} messages in {out}, {size_mb:.1f} MB")
    counts: Counter[str] = Counter()
    for each in recorders:
        counts.update(each.missed.counts())
    missed = ", ".join(f"{count} {topic}" for topic, count in counts.items())
    if missed and messages:
        say("record", f"messages that never came, because the fabric drops them on a busy machine: {missed}")
    if left_out := sum(each.left_out for each in recorders):
        say("record", f"{left_out} error, remote or CAN FD frames are missing: {out.suffix} does not hold them")
    if lost := sum(each.lost for each in recorders):
        say("record", f"{lost} frames or messages came too fast for this machine and are missing")
