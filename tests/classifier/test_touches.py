"""Touches of a recording from onset to lift, and the labels of marks and of the file beside it."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from canskin.messages import CONTACTS, MARK, Mark, Topic
from classifier import touches
from classifier.touches import Span, add_labels, labels_path, read_labels, read_touches
from dbc.contract import Contract
from recording.sinks import McapSink
from skin.layout import Layout
from tests import messages as make
from tests.recordings import HOLD, REST, START_NS, write_touches

MS = 1_000_000
FORCE_N = np.full((4, 32, 32), 0.001, np.float32)


@pytest.fixture
def run(tmp_path: Path, layout: Layout) -> Path:
    """Four touches: a cup, two of which nothing is said, a ball."""
    return write_touches(tmp_path / "run.mcap", layout, FORCE_N, ["cup", "", "-", "ball"])


def labels(path: Path) -> list[str]:
    return [each.label for each in read_touches(path, pytest.fail).touches]


def write(path: Path, layout: Layout, *told: tuple[int, Topic, msgspec.Struct]) -> Path:
    """Write messages, each with its time in milliseconds."""
    sink = McapSink(path, Contract.from_layout(layout), START_NS, START_NS)
    for time_ms, topic, message in told:
        sink.message(topic, START_NS + time_ms * MS, msgspec.msgpack.encode(message))
    sink.close()
    return path


def felt(time_ms: int, *, force_n: float = 0.1, count: int = 1, doubtful: bool = False, blind: bool = False) -> tuple:
    contact = make.contact(force_n=force_n, taxels=5, doubtful_since_mono_ns=int(doubtful))
    contacts = make.contacts(time_ms + 1, *[contact] * count, sampled_mono_ns=time_ms * MS, blind=blind)
    return time_ms, CONTACTS, contacts


def seen(path: Path) -> list[tuple[float, float]]:
    found = read_touches(path, pytest.fail)
    return [((each.begin_ns - START_NS) / MS, (each.end_ns - START_NS) / MS) for each in found.touches]


def test_a_touch_has_times_force_area_and_the_label_of_its_mark(run: Path) -> None:
    found = read_touches(run, pytest.fail)
    assert [each.number for each in found.touches] == [1, 2, 3, 4]
    assert [each.label for each in found.touches] == ["cup", "", "", "ball"]
    first = found.touches[0]
    assert (first.begin_ns - START_NS, first.end_ns - START_NS) == ((REST + 1) * 50 * MS, (REST + HOLD) * 50 * MS)
    assert (first.taxels, first.contacts, len(first.cycles)) == (1024, 1, HOLD)
    assert first.force_n == pytest.approx(1.024)


def test_lost_messages_part_no_touch_and_a_lift_does(tmp_path: Path, layout: Layout) -> None:
    told = [felt(0), felt(40), felt(60, count=0), felt(140), felt(240), felt(1240)]
    told += [felt(2300), felt(2400), felt(2450, count=0), felt(2520), felt(2600)]
    assert seen(write(tmp_path / "run.mcap", layout, *told)) == [(0, 1240), (2300, 2400), (2520, 2600)]


def test_a_slow_skin_has_whole_touches_and_untouched_cycles_beside_none(tmp_path: Path, layout: Layout) -> None:
    path = write(tmp_path / "run.mcap", layout, *(felt(500 * place, count=int(3 <= place <= 5)) for place in range(9)))
    assert seen(path) == [(1500, 2500)]
    assert [each.cycle for each in read_touches(path, pytest.fail).untouched] == [1, 501, 3501, 4001]


def test_short_and_doubtful_contacts_are_no_touch_and_near_them_nothing_is_untouched(
    tmp_path: Path, layout: Layout
) -> None:
    told = [felt(0, count=0), felt(90), felt(100), felt(300, doubtful=True), felt(400, doubtful=True)]
    told += [felt(490, count=0), felt(500, count=0), felt(501, count=0), felt(502, count=0)]
    told += [felt(900, count=0, blind=True), felt(1000, count=2), felt(1050, count=3)]
    path = write(tmp_path / "run.mcap", layout, *told)
    found = read_touches(path, pytest.fail)
    assert seen(path) == [(1000, 1050)]
    assert found.touches[0].contacts == 3
    assert [each.sampled_mono_ns // MS for each in found.untouched] == [501]


def test_a_mark_during_a_touch_counts_where_it_holds_for_most_of_the_touch(tmp_path: Path, layout: Layout) -> None:
    first = [felt(each) for each in (0, 20, 40, 60, 80)] + [felt(200, count=0)]
    second = [felt(each) for each in (300, 320, 340, 360, 380)]
    marks = [(30, MARK, Mark(label="cup")), (350, MARK, Mark(label=""))]
    path = write(tmp_path / "run.mcap", layout, *sorted([*first, *second, *marks], key=lambda each: each[0]))
    assert labels(path) == ["cup", "cup"]


def test_a_mark_that_no_object_can_have_is_told(tmp_path: Path, layout: Layout) -> None:
    path = write(tmp_path / "run.mcap", layout, (0, MARK, Mark(label=" cup")), felt(10), felt(80))
    told: list[str] = []
    assert read_touches(path, told.append).touches[0].label == ""
    assert len(told) == 1
    assert "a mark is left out" in told[0]


def test_the_newest_label_beside_a_recording_counts_and_an_empty_one_removes(run: Path) -> None:
    before = run.read_bytes()
    found = read_touches(run, pytest.fail).touches
    add_labels(run, [Span(found[1].begin_ns, found[2].end_ns, "pen")])
    assert labels(run) == ["cup", "pen", "pen", "ball"]
    add_labels(run, [Span(each.begin_ns, each.end_ns, "") for each in (found[0], found[1])])
    assert labels(run) == ["", "", "pen", "ball"]
    assert run.read_bytes() == before
    assert labels_path(run).name == "run.labels.json"


def test_labels_that_others_cover_are_dropped(run: Path) -> None:
    for name in ("a", "b", "c"):
        add_labels(run, [Span(START_NS, START_NS + 10, name)])
    assert [each.label for each in read_labels(run)] == ["c"]


def test_a_write_that_fails_loses_nothing(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    add_labels(run, [Span(START_NS, START_NS + 10, "a")])

    def full(*_: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr(touches, "write_file", full)
    with pytest.raises(OSError, match="no space"):
        add_labels(run, [Span(START_NS, START_NS + 10, "b")])
    assert [each.label for each in read_labels(run)] == ["a"]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"{", "damaged labels"),
        (b'{"version": 2, "spans": []}', "version 2 of labels"),
        (b'{"version": 1, "spans": [{"begin_ns": 1, "end_ns": 2, "label": "a\\nb"}]}', "expected printable text"),
    ],
)
def test_a_file_of_labels_that_cannot_be_read_is_refused(run: Path, content: bytes, says: str) -> None:
    labels_path(run).write_bytes(content)
    with pytest.raises(InputError, match=says):
        read_touches(run, pytest.fail)


def test_a_recording_without_contacts_is_refused(tmp_path: Path, layout: Layout) -> None:
    path = write(tmp_path / "run.mcap", layout, (0, MARK, Mark(label="cup")))
    with pytest.raises(InputError, match="holds no contacts: start 'skin reconstruct'"):
        read_touches(path, pytest.fail)


def test_touches_of_nothing_are_none(tmp_path: Path, layout: Layout) -> None:
    path = write(tmp_path / "run.mcap", layout, felt(0, count=0))
    found = read_touches(path, pytest.fail)
    assert (found.begin_ns, found.touches, len(found.untouched)) == (START_NS, [], 1)
