"""``skin load`` on live buses: the links are closed whatever happens, and lost frames are an error."""

from typing import Any

import pytest

from bandwidth import load_command
from bus.options import BusOptions
from canskin.errors import RunError
from dbc.frame import Frames, frames
from skin.layout import load_layout


class Ear:
    def __init__(self, dropped: int = 0) -> None:
        self.dropped = dropped
        self.closed = 0

    def close(self) -> None:
        self.closed += 1


def listened(monkeypatch: pytest.MonkeyPatch, links: dict[int, Ear], seen: Any) -> tuple[Any, list[Any]]:
    told: list[Any] = []

    def open_links(_layout: object, options: BusOptions, *, name: str, sends: bool) -> dict[int, Ear]:
        assert not sends
        told.append((options.interface, name))
        return links

    def listen(given: dict[int, Ear], seconds: float, stopped: Any) -> Any:
        told.append((given is links, seconds, stopped()))
        if isinstance(seen, Exception):
            raise seen
        return seen

    monkeypatch.setattr(load_command, "open_links", open_links)
    monkeypatch.setattr(load_command, "listen", listen)
    monkeypatch.setattr(load_command, "say", lambda *words: told.append(words))
    monkeypatch.setattr(load_command.StopSignal, "install", lambda self: self)
    return load_command._listen(load_layout(), BusOptions("socketcan"), 2.5), told


def test_every_link_is_closed_behind_what_was_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    links, seen = {0: Ear(), 2: Ear()}, {0: frames(3), 2: frames(1)}
    got, told = listened(monkeypatch, links, seen)
    assert got is seen
    assert told == [("socketcan", "load"), ("load", "listening for 2.5 s"), (True, 2.5, False)]
    assert [link.closed for link in links.values()] == [1, 1]


def test_links_are_closed_when_listening_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    links = {0: Ear(), 1: Ear()}
    with pytest.raises(OSError, match="unplugged"):
        listened(monkeypatch, links, OSError("unplugged"))
    assert [link.closed for link in links.values()] == [1, 1]


def test_frames_that_were_lost_on_the_way_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    links = {0: Ear(2), 1: Ear(3)}
    seen: dict[int, Frames] = {}
    with pytest.raises(RunError, match=r"^5 frames were lost on the way to this program: the load would be too low"):
        listened(monkeypatch, links, seen)
    assert [link.closed for link in links.values()] == [1, 1]
