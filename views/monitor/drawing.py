"""The lines of a skin's state on a terminal."""

import time
from collections.abc import Sequence
from functools import lru_cache
from itertools import zip_longest
from textwrap import wrap
from typing import Final

from rich.text import Text

from health.causes import ERROR, INFO, WARNING, Cause
from health.nodes_why import NMT_WORDS, link_cause
from health.snapshot import BusView, Notice, Service, Snapshot

#: A line and its style.
Line = tuple[str, str]
#: Keys of what is shown, and its name.
SHOWN: Final = {"a": "all", "b": "buses", "n": "nodes", "s": "services", "w": "wrong"}
#: What is wrong has another key, too.
ALIASES: Final = {"/": "w"}
_STYLES: Final = {ERROR: "bold red", WARNING: "yellow", INFO: ""}
_HEADING: Final = "bold cyan"
_FAINT: Final = "dim"
_BAR: Final = 10
_DAY_S: Final = 86_400
#: Between two columns, and between two nodes in one line.
_GAP: Final = "  "
_WIDE_GAP: Final = "   "
_MIB: Final = 1 << 20


def screen(state: Snapshot, shown: str, size: tuple[int, int], first: int = 0) -> tuple[list[Text], int]:
    """Return the lines of a terminal, and which line of the content is at the top.

    Parameters
    ----------
    shown : str
        A key of `SHOWN`.
    size : (int, int)
        Columns and lines of the terminal.
    first : int
        Line of the content that is wanted at the top.
    """
    width, height = size
    head, lines = _head(state), body(state, shown, width)
    room = max(0, height - len(head) - 1)
    first = max(0, min(first, len(lines) - room))
    keys = _keys(shown, first, len(lines) - first - room)
    seen = [Text(text, style) for text, style in lines[first : first + room]]
    blank = [Text()] * (room - len(seen))
    return [_cut(line, width) for line in (*head, *seen, *blank, keys)][:height], first


def whole(state: Snapshot, width: int) -> list[str]:
    """Return all that `screen` can show, for a file or a pipe: tables may be wider than `width`."""
    return [line.plain for line in _head(state)] + [text for text, _ in body(state, "a", width)]


def body(state: Snapshot, shown: str, width: int) -> list[Line]:
    """Return the lines between head and keys, those of nodes that are whole last."""
    is_all, is_wrong = shown == "a", shown == "w"
    lines = _notices(state, width) if is_all or is_wrong else []
    if is_all or is_wrong or shown == "b":
        lines += _buses(state, all_of=not is_wrong)
    if is_all or is_wrong or shown == "s":
        lines += _services(state, all_of=not is_wrong)
    if is_all or is_wrong or shown == "n":
        lines += _troubled(state)
    if is_all or shown == "n":
        lines += _nodes(tuple(state.gateway.buses if state.gateway else ()), width)
    return lines or [("nothing is wrong", "green")]


def _head(state: Snapshot) -> list[Text]:
    figures, gateway, label = state.figures, state.gateway, state.label
    counts = [sum(each.level == level for each in state.notices) for level in (ERROR, WARNING)]
    head = Text.assemble((f" {state.skin} ", "reverse"), "  ")
    for count, level in zip(counts, (ERROR, WARNING), strict=True):
        if count:
            head.append(f"{count} {level}{'s' * (count > 1)}{_GAP}", _STYLES[level])
    if not any(counts):
        head.append(f"nothing is wrong{_GAP}", "green")
    if label is not None and not label.stale and label.measured:
        head.append(f"{label.label} {label.confidence:.0%}" if label.label else "untouched")
    if (patch := next(iter(state.patches), None)) is not None and patch.force_n is not None:
        head.append(f"{_GAP}{patch.force_n:.3g} N")
    rates = [_clock(state.time_s)]  # all within 80 columns
    if gateway is not None and not gateway.stale:
        rates.append(f"SYNC {_rate(gateway.sync_rate_hz)} Hz")
    rates.append(f"{_rate(figures.images_hz)} images/s")
    if figures.latency_p50_s is not None and figures.latency_p99_s is not None:
        rates.append(f"{1e3 * figures.latency_p50_s:.1f} ms, p99 {1e3 * figures.latency_p99_s:.1f} ms")
    if figures.valid_blocks_low is not None:
        rates.append(f"least {figures.valid_blocks_low}/{figures.blocks} blocks")
    return [head, Text(f" {_GAP.join(rates)}")]


def _rate(rate_hz: float) -> str:
    return f"{rate_hz:.0f}" if rate_hz >= 10 else f"{rate_hz:.1f}"


def _keys(shown: str, above: int, below: int) -> Text:
    line = Text(style=_FAINT)
    for key, name in SHOWN.items():
        line.append(f" {key} {name} ", "reverse" if key == shown else "")
    line.append(" q quit ")
    if below > 0 or above:
        line.append(f" ↑↓ {above} above, {max(0, below)} below")
    return line


def _notices(state: Snapshot, width: int) -> list[Line]:
    lines = []
    for each in state.notices:
        lines += [(line, _STYLES[each.level]) for line in _wrapped(_words(each, state.time_s), width, 0)]
        lines += [(line, _FAINT) for line in _wrapped(f"→ {each.mend}", width, 2)]
    return lines


def _words(notice: Notice, now_s: float) -> str:
    since = "" if notice.since_time_s is None else f" {_since(notice.since_time_s, now_s)}"
    return f"{notice.level} {notice.code}{since}: {notice.text}"


def _wrapped(text: str, width: int, indent: int) -> list[str]:
    return wrap(text, width, initial_indent=" " * indent, subsequent_indent=" " * (indent + 2), tabsize=1)


def _buses(state: Snapshot, *, all_of: bool) -> list[Line]:
    gateway = state.gateway
    if gateway is None:
        return []
    rows = [(_STYLES[each.level], _bus(each)) for each in gateway.buses if all_of or each.level != INFO]
    headings = ["bus", "load", "", "mean", "link", "nodes", "missing", "late", "overrun", "cause"]
    age = f", {gateway.age_s:.0f} s old" if gateway.stale else ""
    return _table([headings[0] + age, *headings[1:]], rows)


def _bus(bus: BusView) -> list[str]:
    cause = link_cause(bus) or (Cause.OTHER_SYNC if bus.other_sync else None)
    whole = len(bus.nodes) - len(bus.nodes_why)
    full = round(_BAR * min(max(bus.load_ratio, 0), 1))
    counts = sum(bus.missing), sum(bus.late), bus.overrun
    return [
        bus.name,
        "█" * full + "░" * (_BAR - full),
        f"{bus.load_ratio:4.0%}",
        f"{bus.mean_load_ratio:4.0%}",
        bus.link,
        f"{whole} of {len(bus.nodes)}",
        *map(str, counts),
        cause.code if cause else "",
    ]


def _troubled(state: Snapshot) -> list[Line]:
    """Return the nodes that are not whole."""
    rows = []
    for bus in state.gateway.buses if state.gateway else ():
        for each in bus.nodes_why:
            place = bus.nodes.index(each.node)
            nmt = NMT_WORDS.get(bus.nmt[place], "unknown")
            since = _since(each.since_time_s, state.time_s)
            row = [bus.name, str(each.node), nmt, *_times(bus, place), each.code, since, each.why]
            rows.append((_STYLES[Cause.of(each.code).level], row))
    return _table(["not whole", "", "state", "answers", "heartbeats", "missing", "cause", "since", "why"], rows)


@lru_cache(maxsize=1)
def _nodes(buses: tuple[BusView, ...], width: int) -> list[Line]:
    """Return the nodes that are whole, as many in a line as have room."""
    rows = []
    for bus in buses:
        troubled = {each.node for each in bus.nodes_why}
        for place, node in enumerate(bus.nodes):
            if node not in troubled:
                rows.append(("", [bus.name, str(node), *_times(bus, place)]))
    if not rows:
        return []
    heading, *lines = (text for text, _ in _table(["whole", "", "answers", "heartbeats", "missing"], rows))
    side = max(1, (width + len(_WIDE_GAP)) // (len(heading) + len(_WIDE_GAP)))
    high = -(-len(lines) // side)
    columns = [lines[at : at + high] for at in range(0, len(lines), high)]
    packed = [(_WIDE_GAP.join(row), "") for row in zip_longest(*columns, fillvalue="")]
    return [(_WIDE_GAP.join([heading] * len(columns)), _HEADING), *packed]


def _times(bus: BusView, place: int) -> list[str]:
    """Return the least and the longest times of a node, and the number of its frames that did not come."""
    found = []
    for spreads in (bus.answer_s, bus.heartbeat_s):
        least_s, longest_s = spreads[place] if place < len(spreads) else (0.0, 0.0)
        found.append(f"{1e3 * least_s:.0f}-{1e3 * longest_s:.0f} ms" if longest_s else "-")
    return [*found, str(bus.missing[place]) if place < len(bus.missing) else "-"]


def _services(state: Snapshot, *, all_of: bool) -> list[Line]:
    rows = []
    for name, each in state.services.items():
        level, word = _service(each, is_cut_off=state.cut_off)
        if all_of or level != INFO:
            told = [
                "" if each.memory_bytes is None else f"{each.memory_bytes / _MIB:.0f} MiB",
                "" if each.processor_ratio is None else f"{each.processor_ratio:.1%}",
                "" if each.made_per_s is None else f"{each.made_per_s:.1f}/s",
            ]
            about = [_since(each.since_time_s, state.time_s), each.scheduling, each.version]
            rows.append((_STYLES[level], [name, word, *told, str(each.lost), *about]))
    headings = ["service", "", "memory", "core", "made", "lost", "seen since", "scheduling", "version"]
    return _table(headings, rows)


def _service(service: Service, *, is_cut_off: bool) -> tuple[str, str]:
    """Return level and state of a service."""
    if not service.alive:
        return (WARNING, "out of reach") if is_cut_off else (ERROR, "gone")
    if service.difference:
        return ERROR, "differs"
    if service.silent:
        return ERROR, "silent"
    return (INFO, "runs") if service.loses_since_time_s is None else (WARNING, "too slow")


def _table(headings: Sequence[str], rows: Sequence[tuple[str, Sequence[str]]]) -> list[Line]:
    """Return a heading and rows of one style each, with columns of equal width; nothing without rows."""
    if not rows:
        return []
    widths = [max(map(len, column)) for column in zip(headings, *(cells for _, cells in rows), strict=True)]
    return [(_GAP.join(map(str.ljust, cells, widths)), style) for style, cells in ((_HEADING, headings), *rows)]


def _since(time_s: float, now_s: float) -> str:
    if now_s - time_s < _DAY_S:
        return _clock(time_s)
    return f"{(now_s - time_s) / _DAY_S:.0f} days"


def _clock(time_s: float) -> str:
    return time.strftime("%H:%M:%S", time.localtime(time_s))


def _cut(line: Text, width: int) -> Text:
    line.truncate(width, overflow="ellipsis")
    return line
