"""What the page can ask for: tare, record, mark, and play of a recording."""

from collections.abc import Callable
from typing import Annotated, Any, Final, NamedTuple

import msgspec

from canskin.calibration_messages import ANSWER_S, CALIBRATION, CalibrationReply, tare_request
from canskin.connection import RECORDER
from canskin.errors import RunError
from canskin.fabric import Fabric
from canskin.messages import MARK, Mark, check_label
from views.page.playback import SPEED_MAX, SPEED_MIN, Playback
from views.page.record_process import RecorderProcess
from views.page.shown import Live

#: All names.
ACTIONS: Final = ("tare", "record", "mark", "play")


class Tare(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Measure the zero of the skin, or take what stands on a region for its zero; see `tare_request`."""

    region: str | None = None
    force: bool = False


class Record(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Start or stop a recording."""

    on: bool


class SetMark(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Say what touches the skin, see `canskin.messages.Mark`."""

    label: str


class Play(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Go to a position of the recording, seconds from its beginning; hold or go on; at another speed."""

    position_s: Annotated[float, msgspec.Meta(ge=0)] | None = None
    is_paused: bool | None = None
    speed: Annotated[float, msgspec.Meta(ge=SPEED_MIN, le=SPEED_MAX)] | None = None


class Action(NamedTuple):
    """What a request has to be, and what does it; it returns what was done in words, or raises SkinError."""

    asked: type[msgspec.Struct]
    act: Callable[[Any], str]


def live_actions(live: Live, fabric: Fabric, recorder: RecorderProcess) -> dict[str, Action]:
    """Return what can be asked of a running skin, by name."""

    def tare(asked: Tare) -> str:
        taxels = live.layout.taxels
        request = tare_request(taxels.rows, taxels.columns, force=asked.force, region=asked.region)
        reply: CalibrationReply = fabric.ask(CALIBRATION, request, ANSWER_S)
        if not reply.is_done:
            is_touched = not asked.force and "touches" in reply.text
            more = "; by force, what touches it becomes part of the zero" if is_touched else ""
            raise RunError(f"{reply.text}{more}")
        return reply.text

    def record(asked: Record) -> str:
        if not asked.on:
            return recorder.stop()
        before = live.running(RECORDER)
        return recorder.start(lambda: bool(live.running(RECORDER) - before))

    def mark(asked: SetMark) -> str:
        label = check_label(asked.label)
        if not live.running(RECORDER):
            raise RunError("nothing is recorded, and the mark would be lost: start a recording first")
        fabric.publish(MARK, Mark(label=label))
        return f"marked: {label}" if label else "marked: no label from now on"

    return {"tare": Action(Tare, tare), "record": Action(Record, record), "mark": Action(SetMark, mark)}


def playback_actions(playback: Playback) -> dict[str, Action]:
    """Return what can be asked of a recording, by name."""
    return {"play": Action(Play, lambda asked: playback.play(asked.position_s, asked.is_paused, asked.speed))}
