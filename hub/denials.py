"""What the hub denied, as lines for its log: zenoh prints that to stdout alone, among many other lines."""

import fcntl
import os
import re
import threading
import time
from collections.abc import Callable, Collection
from typing import Final

from canskin.keys import parts_of
from canskin.roles import Action, roles_for
from canskin.text import plain

#: Most lines about the names that one holder invents in `PERIOD_S`: they have no end.
MOST_LINES: Final = 20
#: A denial is told once in this time.
PERIOD_S: Final = 3600.0
#: Longest name of a key that is told.
NAME_MAX: Final = 100
#: Most sessions whose holders are known, the newest, and most denials that are known without another look.
MOST_SESSIONS: Final = 4096
_CHUNK: Final = 1 << 20
#: A pipe that has less is read again after `PAUSE_S` only, because each turn costs as much as many lines.
_LITTLE: Final = 1 << 16
PAUSE_S: Final = 0.1
#: Length of the time in a line.
_WHEN: Final = len("\x1b[2m2026-01-01T00:00:00.000000Z")
#: What a line that counts has; most lines have neither.
_PARTS: Final = (b" (ingress) ", b"): caching ", b" did not match ")
#: A line of zenoh begins with a colour, which it escapes in the names of programs: they cannot imitate a line.
_LINE: Final = re.compile(
    rb"\x1b\[2m\S+ .*?(?P<thread>ThreadId\(\d+\)).*?access_control.*?\x1b\[0m (?:"
    rb"ACL \((?P<ahead>ingress|egress)\): caching permissions"
    rb"|(?P<stranger>\w+) did not match any configured ACL subject"
    rb"|(?:Using cached result: )?(?P<session>\w+)(?: on .*?CertCommonName\((?P<holder>.*?)\)\+.*?)?"
    rb" is (?P<denied>un)?authorized to (?P<what>[\w/ ]+) \(ingress\) on (?P<key>.*))"
)
_ACTIONS: Final[dict[str, Action]] = {
    "Put": "put",
    "Declare Subscriber": "subscribe",
    "Query": "ask",
    "Declare Queryable": "answer",
    "Reply": "answer",
    "Liveliness Token": "appear",
}


class Denials:
    """Tells each denial once in `PERIOD_S`: who may not do what, and who may.

    Parameters
    ----------
    say : callable
        Takes a line.
    revoked : collection of str
        Common names of keys that are revoked.
    clock : callable, optional
        Monotonic time in seconds.
    """

    def __init__(
        self,
        say: Callable[[str], None],
        revoked: Collection[str] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._say, self._revoked, self._clock = say, revoked, clock
        self._since_s = clock()
        self._holders: dict[bytes, str] = {}
        self._ahead: set[bytes] = set()
        self._known: set[int] = set()  # hashes: a name may be long
        self._said: dict[tuple[str, bool], set[str]] = {}

    def take(self, content: bytes) -> None:
        """Take whole lines of zenoh."""
        if self._clock() - self._since_s >= PERIOD_S:
            self._since_s = self._clock()
            self._known.clear()
            self._said.clear()
        for line in content.split(b"\n"):
            # What a session is denied is printed each time: a flood must not take the processor.
            if hash(line[_WHEN:]) not in self._known and any(part in line for part in _PARTS):
                self._take(line)

    def _take(self, line: bytes) -> None:
        found = _LINE.match(line)
        if found is None:
            return
        if found["ahead"]:  # of a new key: first all decisions for what comes in, then those for what goes out
            (self._ahead.add if found["ahead"] == b"ingress" else self._ahead.discard)(found["thread"])
        elif found["stranger"]:
            self._tell(
                "keys that are not in the list of holders",
                "may do nothing: copy the hub's keys here, and start it again",
            )
        else:
            self._take_decision(found)

    def _take_decision(self, found: re.Match[bytes]) -> None:
        if found["holder"] is not None:
            if len(self._holders) >= MOST_SESSIONS:
                self._holders.pop(next(iter(self._holders)))
            self._holders[found["session"]] = plain(found["holder"].decode(errors="replace"))
        holder = self._holders.get(found["session"])
        if found["denied"] and holder is not None and found["thread"] not in self._ahead:
            if len(self._known) >= MOST_SESSIONS:
                self._known.clear()
            self._known.add(hash(found.string[_WHEN:]))
            self._deny(holder, found["what"].decode(), found["key"].decode(errors="replace"))

    def _deny(self, holder: str, what: str, key: str) -> None:
        if holder in self._revoked:
            self._tell(holder, "may do nothing: these keys are revoked")
            return
        action = _ACTIONS.get(what)
        name = key.removeprefix(f"canskin/{parts_of(holder)[0]}/")
        if action == "appear":
            name = name.removeprefix("alive/").partition("/")[0]
        allowed = ", ".join(roles_for(action, name)) if action else ""
        verb = "appear as" if action == "appear" else action or what.lower()
        said = f"may not {verb} '{plain(name[:NAME_MAX])}'"
        self._tell(holder, f"{said}: {allowed} may" if allowed else said, is_invented=not allowed)

    def _tell(self, holder: str, text: str, *, is_invented: bool = False) -> None:
        said = self._said.setdefault((holder, is_invented), set())
        if text in said or (is_invented and len(said) > MOST_LINES):
            return
        said.add(text)
        is_last = is_invented and len(said) > MOST_LINES
        self._say(f"{holder}: no more names that it invents are told" if is_last else f"{holder} {text}")


def read_stdout(take: Callable[[bytes], None]) -> None:
    """Give `take` all that this process prints to stdout from now on, in whole lines, in a thread of its own."""
    reading, writing = os.pipe()
    if hasattr(fcntl, "F_SETPIPE_SZ"):  # Linux: zenoh waits while the pipe is full
        fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, _CHUNK)
    os.dup2(writing, 1)
    os.close(writing)

    def read() -> None:
        rest = b""
        with open(reading, "rb", buffering=0) as printed:  # noqa: PTH123 - a pipe
            while content := printed.read(_CHUNK):
                lines, end, rest = (rest + content).rpartition(b"\n")
                if end:
                    take(lines)
                rest = rest[-_CHUNK:]
                if len(content) < _LITTLE:
                    time.sleep(PAUSE_S)

    threading.Thread(target=read, name="denials", daemon=True).start()


def ignore_stdout() -> None:
    """End `read_stdout`."""
    with open(os.devnull, "wb") as nothing:  # noqa: PTH123
        os.dup2(nothing.fileno(), 1)
