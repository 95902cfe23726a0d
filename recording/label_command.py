"""``skin label``: the touches of a recording, and their labels."""

import re
from pathlib import Path
from typing import Final

from canskin.errors import InputError, RunError
from canskin.messages import check_label
from classifier.touches import Span, Touches, add_labels, labels_path, read_touches
from recording import RECORDING_SUFFIX, file_of, is_recording
from recording.mcap_file import part_of
from shell.service import say
from shell.terminal import Json, print_json, print_table

_NUMBERS: Final = re.compile(r"(\d+)(?:-(\d+))?")
_TIMES: Final = re.compile(r"(\d+(?:\.\d+)?):(\d+(?:\.\d+)?)")


def label(source: Path, *labels: str, skin: str | None = None, json: Json = False) -> None:
    """List the touches of a recording; set or remove their labels.

    A touch lasts from the onset of contact to the lift. Its label is that of the marks during most of its time
    (``skin record --label``, the page, ``skin.mark`` of the client), unless this verb has set another. Set
    labels stand beside the recording, ``run.labels.json`` beside ``run.mcap``: move both files together.

    Parameters
    ----------
    source
        A recording (.mcap) with contacts.
    labels
        What to set: NUMBER=LABEL or FIRST-LAST=LABEL of touches, BEGIN:END=LABEL of a time, seconds in the recording.
        An empty LABEL removes labels.
    skin
        Name of the skin, where the recording has several: its labels are in ``run-SKIN.labels.json``.
    json
        Print one JSON list, also of times in nanoseconds.

    Examples
    --------
    skin label run.mcap
    skin label run.mcap 3=cup 4-9=ball 10=
    skin label run.mcap 12.5:40=cup
    """
    if not is_recording(source) or not file_of(source).is_file():
        raise InputError(f"{source}: expected a recording of 'skin record' ({RECORDING_SUFFIX})")
    source = part_of(source, skin)

    def warn(line: str) -> None:
        say("label", line)

    found = read_touches(source, warn)
    if labels:
        spans = [span for text in labels for span in _spans(text, found)]
        try:
            add_labels(source, spans)
        except OSError as error:
            path = labels_path(source)
            raise RunError(f"{path}: the labels cannot be written: {error.strerror or error}") from error
        found = read_touches(source, warn)
    _show(found, as_json=json)


def _spans(text: str, found: Touches) -> list[Span]:
    """Return the labels that an argument sets."""
    where, equals, name = text.partition("=")
    numbers, times = _NUMBERS.fullmatch(where), _TIMES.fullmatch(where)
    if not equals or not (numbers or times):
        raise InputError(
            f"'{text}': expected NUMBER=LABEL or FIRST-LAST=LABEL of touches, or BEGIN:END=LABEL in seconds, for"
            " example 3=cup, 4-9=ball, 12.5:40=cup"
        )
    check_label(name)
    if times:
        begin_ns, end_ns = (found.begin_ns + round(float(each) * 1e9) for each in times.groups())
        if end_ns <= begin_ns or begin_ns > found.end_ns:
            last_s = (found.end_ns - found.begin_ns) * 1e-9
            raise InputError(f"'{text}': expected a time of the recording, 0:{last_s:.1f}, that ends after its begin")
        return [Span(begin_ns, end_ns, name)]
    assert numbers is not None  # noqa: S101 - one of both matched
    first, last = int(numbers[1]), int(numbers[2] or numbers[1])
    if not 1 <= first <= last <= len(found.touches):
        raise InputError(f"'{text}': expected touches from 1 to {len(found.touches)}, the first before the last")
    return [Span(each.begin_ns, each.end_ns, name) for each in found.touches[first - 1 : last]]


def _show(found: Touches, *, as_json: bool) -> None:
    touches = found.touches
    if as_json:
        print_json(
            [
                {name: getattr(each, name) for name in each.__dataclass_fields__ if name != "cycles"}
                | {"begin_s": (each.begin_ns - found.begin_ns) * 1e-9, "cycles": len(each.cycles)}
                for each in touches
            ]
        )
        return
    print_table(
        ("touch", "begins, s", "lasts, s", "taxels", "force, N", "contacts", "label"),
        [
            (
                each.number,
                f"{(each.begin_ns - found.begin_ns) * 1e-9:.2f}",
                f"{(each.end_ns - each.begin_ns) * 1e-9:.2f}",
                each.taxels,
                f"{each.force_n:.3f}",
                each.contacts,
                each.label,
            )
            for each in touches
        ],
    )
    labelled = sum(bool(each.label) for each in touches)
    say("label", f"{len(touches)} touches, {labelled} with a label, {len(found.untouched)} untouched cycles")
