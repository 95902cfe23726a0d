"""A recording on the page: held, moved, hurried, and shown as it was recorded."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError, RunError
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, MARK, TRUTH, Mark, Topic
from recording.mcap_file import LAYOUT_FILE, File, RecordingWriter
from shell.skin_options import SkinOptions
from skin.layout import layout_text
from views.page import command
from views.page.playback import STEP_S, Playback

FIRST_S = 1_700_000_000
CYCLES = 1000


def recorded(messages: Any, path: Path, *, closes: bool = True) -> Path:
    """Write ten seconds of a touch whose force grows, in chunks of half a second."""
    layout = File(LAYOUT_FILE, "application/toml", layout_text(messages.layout).encode())
    writer = RecordingWriter(path, {}, [layout], 0)

    def write(topic: Topic, at_s: float, message: msgspec.Struct) -> None:
        time_ns = FIRST_S * 1_000_000_000 + round(at_s * 1e9)
        writer.message(topic, time_ns, msgspec.msgpack.encode(message))

    for cycle in range(CYCLES):
        at_s, pixels = cycle / 100, messages.grid(0.01 * cycle / CYCLES)
        write(TRUTH, at_s, messages.truth(cycle + 1, sync_s=at_s + 5, true=pixels))
        write(IMAGE, at_s, messages.image(cycle + 1, sync_s=at_s + 5, pixels=pixels))
        write(CONTACTS, at_s, messages.contacts(cycle + 1, sync_s=at_s + 5))
        write(LABEL, at_s, messages.label(cycle=cycle + 1, sync_s=at_s + 5))
        if cycle % 20 == 0:
            write(GATEWAY, at_s, messages.gateway(cycles=cycle + 1))
        if cycle == 250:
            write(MARK, at_s, Mark(label="cup"))
        if cycle % 50 == 49:
            writer.flush()
    if closes:
        writer.close()
    else:
        writer.abandon()
    return path


class Player:
    """A playback whose clock the test moves."""

    def __init__(self, path: Path, messages: Any) -> None:
        self.now_s = 0.0
        self.playback = Playback(path, messages.layout, clock_s=lambda: self.now_s)
        self.now_s = 0.005  # between two cycles

    def after(self, seconds: float) -> Any:
        """Return the snapshot after a time in which a page looks 25 times a second."""
        for _ in range(round(seconds * 25)):
            self.now_s += 0.04
            self.playback.snapshot()
        return self.playback.snapshot()[0]


@pytest.fixture
def player(messages: Any, tmp_path: Path) -> Player:
    return Player(recorded(messages, tmp_path / "run.mcap"), messages)


def test_it_is_played_as_it_was_recorded(player: Player, messages: Any) -> None:
    snapshot = player.after(2.0)
    pictures = player.playback.snapshot()[1]
    assert (snapshot.playback.speed, snapshot.playback.is_paused) == (1.0, False)
    assert snapshot.playback.duration_s == pytest.approx(9.99)
    assert snapshot.playback.path.endswith("run.mcap")
    assert snapshot.playback.position_s == pytest.approx(2.005)
    assert snapshot.time_s == pytest.approx(FIRST_S + 2.005)
    shown = snapshot.image, snapshot.contacts, snapshot.label
    assert [each.cycle for each in shown] == [snapshot.truth.step] * 3 == [201] * 3
    assert not snapshot.image.stale
    np.testing.assert_array_equal(pictures.image, messages.grid(0.01 * 200 / CYCLES))
    assert snapshot.figures.images_hz == pytest.approx(100)
    assert [each.text for each in snapshot.notices if each.level == "error"] == []


def test_it_is_held_moved_and_hurried(player: Player) -> None:
    player.after(1.0)
    assert player.playback.play(is_paused=True) == "held at 1.0 s of 10.0 s"
    assert player.after(3.0).image.cycle == 101
    player.playback.play(position_s=7.255)
    held = player.after(1.0)
    assert (held.image.cycle, held.gateway.stale, held.playback.is_paused) == (726, False, True)
    player.playback.play(position_s=2.005, speed=4.0, is_paused=False)
    assert player.after(1.0).image.cycle == 601
    player.playback.play(speed=0.5)
    assert player.after(1.0).image.cycle == 651


def test_the_end_is_held_and_the_beginning_follows_it(player: Player) -> None:
    player.playback.play(position_s=9.5)
    end = player.after(2.0)
    assert (end.image.cycle, end.playback.is_paused) == (CYCLES, True)
    assert end.playback.position_s == end.playback.duration_s
    assert not player.after(2.0).image.stale
    player.playback.play(is_paused=False)
    assert player.after(1.0).image.cycle == 101
    assert player.playback.play(position_s=1e9) == "held at 10.0 s of 10.0 s"


def test_no_time_passes_while_no_page_looks(player: Player) -> None:
    player.after(1.0)
    player.now_s += 3600
    assert player.playback.snapshot()[0].playback.position_s == pytest.approx(1.005 + STEP_S)


def test_the_history_is_that_of_the_recording_and_begins_anew_elsewhere(player: Player, messages: Any) -> None:
    player.after(2.0)
    told = player.playback.history(FIRST_S + 1.05)
    assert told["time_s"][0] == pytest.approx(FIRST_S + 1.1, abs=0.1)
    assert told["force_n"] == sorted(told["force_n"])
    assert player.playback.frame(told["time_s"][0]) is not None
    player.playback.play(position_s=8.0)
    assert player.playback.history(float("-inf"))["time_s"][0] == pytest.approx(FIRST_S + 6.5, abs=0.2)
    assert player.playback.frame(told["time_s"][0]) is None


def test_the_mark_before_a_position_holds_there(player: Player) -> None:
    marks = []
    for position_s in (1.0, 9.0, 2.0):
        player.playback.play(position_s=position_s)
        player.after(0.2)
        marks.append(player.playback.history(float("-inf"))["mark"][-1])
    assert marks == [None, "cup", None]


def test_a_recording_after_a_crash_is_shown_and_moved(messages: Any, tmp_path: Path, capfd: Any) -> None:
    player = Player(recorded(messages, tmp_path / "cut.mcap", closes=False), messages)
    player.playback.play(position_s=6.005)
    assert player.after(0.0).image.cycle == 601
    assert player.after(10.0).image.cycle == CYCLES
    player.playback.play(position_s=6.005)
    player.after(10.0)
    assert capfd.readouterr().err.count("has no end") == 1


def test_a_recording_that_was_removed_can_be_moved_and_shows_nothing(
    player: Player, capfd: pytest.CaptureFixture[str]
) -> None:
    player.playback.path.unlink()
    assert player.playback.play(position_s=5.0) == "played at 1 times its speed at 5.0 s of 10.0 s"
    assert player.after(1.0).image is None
    assert capfd.readouterr().err.count("run.mcap") == 1


def test_a_message_that_cannot_be_read_ends_what_is_shown(messages: Any, tmp_path: Path, capfd: Any) -> None:
    writer = RecordingWriter(tmp_path / "odd.mcap", {}, [], 0)
    writer.message(IMAGE, 1_000_000_000, msgspec.msgpack.encode(messages.image(5)))
    writer.message(IMAGE, 2_000_000_000, b"odd")
    writer.message(IMAGE, 3_000_000_000, msgspec.msgpack.encode(messages.image(6)))
    writer.close()
    player = Player(tmp_path / "odd.mcap", messages)
    assert player.after(5.0).image.cycle == 5
    assert "cannot be decoded" in capfd.readouterr().err


def test_a_recording_without_images_is_replayed_first(
    messages: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layout = File(LAYOUT_FILE, "application/toml", layout_text(messages.layout).encode())
    bare = tmp_path / "bare.mcap"
    writer = RecordingWriter(bare, {}, [layout], 0)
    writer.message(GATEWAY, 1, msgspec.msgpack.encode(messages.gateway()))
    writer.close()
    called: list[list[str]] = []
    status = 0

    class Done:
        def __init__(self, words: list[str], **_: Any) -> None:
            called.append(words[3:])
            recorded(messages, Path(words[words.index("--out") + 1]))
            self.returncode = status

    monkeypatch.setattr(command.subprocess, "run", Done)
    (tmp_path / "one").mkdir()
    made = command._open(bare, SkinOptions(), tmp_path / "one")
    assert made.path == tmp_path / "one" / "bare.mcap"
    assert called == [["replay", str(bare), "--out", str(made.path)]]
    assert command._open(made.path, SkinOptions(), tmp_path).path == made.path
    assert len(called) == 1
    for code, kind in ((1, RunError), (2, InputError)):
        status, folder = code, tmp_path / str(code)
        folder.mkdir()
        with pytest.raises(kind, match="no images can be made of it"):
            command._open(bare, SkinOptions(), folder)
    with pytest.raises(InputError, match="No such file"):
        command._open(tmp_path / "none.mcap", SkinOptions(), tmp_path)
