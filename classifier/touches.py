"""The touches of a recording, from onset to lift, and their labels.

A touch lasts while the recorded contacts have force that is no error of the zero. Its label is that of most of its
contacts. A contact has the label of the newest mark before it (`canskin.messages.Mark`), unless the file of labels
beside the recording says otherwise of its time. Labels stand in a file of their own, so that no error of ours can
damage a recording. The file is replaced in one step.
"""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from canskin.errors import UNDECODABLE, InputError
from canskin.messages import CONTACTS, MARK, Contacts, check_label
from recording import beside
from recording.mcap_file import Read, Warn, read_messages
from shell.output import write_file
from skin.limits import TEXT_BYTES_MAX, read_file

#: Without contact for longer, a touch has ended.
GAP_NS: Final = 100_000_000
#: Without a message for longer, too: stepped boards at rest say nothing for 0.1 s, slow skins for a cycle.
SILENT_NS: Final = 1_000_000_000
#: Shorter touches are left out.
LEAST_NS: Final = 50_000_000
#: A cycle is of the untouched skin if no contact is nearer: an object presses before the image shows a contact.
MARGIN_NS: Final = 100_000_000
_VERSION: Final = 1


class Span(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A label of the time from `begin_ns` to `end_ns`, both included; an empty label takes labels away."""

    begin_ns: int
    end_ns: int
    label: str


class _LabelsFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    version: int
    spans: list[Span]


class CycleKey(NamedTuple):
    """Tells a measurement of a recording, and all that follows from it."""

    cycle: int
    sampled_mono_ns: int


@dataclass(frozen=True)
class Touch:
    """A touch of a recording.

    Attributes
    ----------
    number : int
        In the order of time, from 1.
    begin_ns, end_ns : int
        When the recorder received its first and its last contact, wall clock.
    cycles : tuple of CycleKey
        Of its contacts.
    force_n : float
        Largest force of all contacts together, newtons.
    taxels, contacts : int
        Largest number of touched taxels, and of contacts at a time.
    label : str
        Empty without label.
    """

    number: int
    begin_ns: int
    end_ns: int
    cycles: tuple[CycleKey, ...]
    force_n: float
    taxels: int
    contacts: int
    label: str


@dataclass(frozen=True)
class Touches:
    """The touches of a recording.

    Attributes
    ----------
    begin_ns, end_ns : int
        Wall clock of the recorder at the first contacts or mark, and at the last contacts.
    touches : list of Touch
    untouched : tuple of CycleKey
        Cycles in which nothing touches the skin, nor shortly before and after.
    """

    begin_ns: int
    end_ns: int
    touches: list[Touch]
    untouched: tuple[CycleKey, ...]


class _Look(NamedTuple):
    """What the contacts of one image show; doubtful contacts have no force."""

    time_ns: int
    key: CycleKey
    force_n: float
    taxels: int
    contacts: int
    is_empty: bool


def labels_path(recording: Path) -> Path:
    """Return the path of the labels beside a recording."""
    return beside(recording, ".labels.json")


def read_labels(recording: Path) -> list[Span]:
    """Return the labels beside a recording, the newest last; none without a file."""
    path = labels_path(recording)
    if not path.exists():
        return []
    content = read_file(path, InputError, "the labels", TEXT_BYTES_MAX)
    try:
        found = msgspec.json.decode(content, type=_LabelsFile)
        if found.version != _VERSION:
            raise InputError(f"{path}: version {found.version} of labels, expected {_VERSION}: of a newer canskin?")
        for each in found.spans:
            check_label(each.label)
    except UNDECODABLE as error:
        raise InputError(f"{path}: damaged labels: {error}; remove the file, and set them again") from error
    return found.spans


def add_labels(recording: Path, added: Sequence[Span]) -> None:
    """Add labels to those beside a recording; they replace older ones of the same time.

    Raises
    ------
    OSError
        If the file cannot be written: the old labels stay.
    """
    kept = [
        old
        for old in read_labels(recording)
        if not any(new.begin_ns <= old.begin_ns and old.end_ns <= new.end_ns for new in added)
    ]
    content = msgspec.json.encode(_LabelsFile(_VERSION, [*kept, *added]))
    write_file(labels_path(recording), msgspec.json.format(content))


def read_touches(recording: Path, warn: Warn) -> Touches:
    """Return the touches of a recording that has contacts."""
    found = touches_of(recording, read_messages(recording, (CONTACTS, MARK), warn), warn)
    if found is None:
        raise InputError(
            f"{recording}: holds no contacts: start 'skin reconstruct' before the recorder, or make contacts with"
            " 'skin replay --out'"
        )
    return found


def touches_of(recording: Path, messages: Iterable[Read], warn: Warn) -> Touches | None:
    """Return the touches of a recording, of its contacts and marks; None without contacts."""
    looks: list[_Look] = []
    marks: list[tuple[int, str]] = []
    for topic, time_ns, message in messages:
        if topic is MARK:
            marks.append((time_ns, _checked(message.label, warn)))
        elif not message.blind:
            looks.append(_look(time_ns, message))
    if not looks:
        return None
    begin_ns = min([each.time_ns for each in looks] + [time_ns for time_ns, _ in marks])
    labels = _Labels(marks, read_labels(recording))
    long = [group for group in _grouped(looks) if group[-1].time_ns - group[0].time_ns >= LEAST_NS]
    touches = [_touch(number, group, labels) for number, group in enumerate(long, 1)]
    return Touches(begin_ns, looks[-1].time_ns, touches, _untouched(looks))


def _grouped(looks: Iterable[_Look]) -> list[list[_Look]]:
    """Return what was seen of each touch."""
    groups: list[list[_Look]] = []
    is_lifted = True
    for each in looks:
        if not each.force_n > 0:
            is_lifted = True
            continue
        apart_ns = each.time_ns - groups[-1][-1].time_ns if groups else 0
        if not groups or apart_ns > (GAP_NS if is_lifted else SILENT_NS):
            groups.append([])
        groups[-1].append(each)
        is_lifted = False
    return groups


def _look(time_ns: int, message: Contacts) -> _Look:
    sure = [each for each in message.contacts if not each.doubtful]
    return _Look(
        time_ns,
        CycleKey(message.cycle, message.sampled_mono_ns),
        sum(each.force_n for each in sure),
        sum(each.taxels for each in sure),
        len(sure),
        not message.contacts,
    )


def _checked(label: str, warn: Warn) -> str:
    """Return the label of a recorded mark, empty where it is none."""
    try:
        return check_label(label)
    except InputError as error:
        warn(f"a mark is left out: {error}")
        return ""


def _touch(number: int, group: Sequence[_Look], labels: "_Labels") -> Touch:
    label, count = Counter(labels.at(each.time_ns) for each in group).most_common(1)[0]
    return Touch(
        number,
        group[0].time_ns,
        group[-1].time_ns,
        tuple(each.key for each in group),
        max(each.force_n for each in group),
        max(each.taxels for each in group),
        max(each.contacts for each in group),
        label if 2 * count > len(group) else "",
    )


def _untouched(looks: Sequence[_Look]) -> tuple[CycleKey, ...]:
    touched_ns = np.array([each.time_ns for each in looks if not each.is_empty], np.int64)
    found = []
    for before, each, after in zip([looks[0], *looks], looks, [*looks[1:], looks[-1]], strict=False):
        place = int(np.searchsorted(touched_ns, each.time_ns))
        is_far = (np.abs(touched_ns[max(0, place - 1) : place + 1] - each.time_ns) > MARGIN_NS).all()
        if before.is_empty and each.is_empty and after.is_empty and is_far:
            found.append(each.key)
    return tuple(found)


class _Labels:
    """Labels by time: of marks, unless a span says otherwise."""

    def __init__(self, marks: Iterable[tuple[int, str]], spans: Sequence[Span]) -> None:
        ordered = sorted(marks, key=lambda mark: mark[0])
        self._times_ns = [time_ns for time_ns, _ in ordered]
        self._names = ["", *(label for _, label in ordered)]
        self._spans = spans

    def at(self, time_ns: int) -> str:
        """Return the label of an instant."""
        for span in reversed(self._spans):
            if span.begin_ns <= time_ns <= span.end_ns:
                return span.label
        return self._names[int(np.searchsorted(self._times_ns, time_ns, side="right"))]
