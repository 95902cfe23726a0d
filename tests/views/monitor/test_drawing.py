"""The lines of a skin's state: all within the terminal, and all that is wrong is named."""

import re
import time
from io import StringIO
from typing import Final

import msgspec
import pytest
from rich.cells import cell_len
from rich.console import Console

from canskin.messages import NodeFault
from canskin.peers import Peer
from health.snapshot import Snapshot
from health.state import ViewState
from tests.health.helpers import Messages
from tests.messages import bus_state, gateway_status, service_status
from views.monitor.command import MOVES, REDRAW, Display
from views.monitor.drawing import SHOWN, body, screen

SIZES: Final = ((80, 24), (200, 50))
ERASED: Final = "\x1b[2K"
UP, DOWN, *_ = MOVES
HEAD: Final = 2
KEYS: Final = 1


def drawn(state: Snapshot, shown: str = "a", size: tuple[int, int] = (200, 50), first: int = 0) -> list[str]:
    return [line.plain for line in screen(state, shown, size, first)[0]]


def healthy(name: str = "left") -> ViewState:
    """A skin of which all is well: two buses, four nodes each, and one service."""
    messages = Messages()
    state = ViewState(messages.layout, epoch_s=1000.0)
    for service in ("gateway", "reconstructor"):
        state.take_peer(Peer("palm", service, "1", scheduling="realtime"), True, 0.0)
    for second in (1, 2):
        state.take(service_status(second), float(second))
        for tenth in range(10):
            sync_s = second + tenth / 10 - 0.9
            state.take(messages.image(10 * second + tenth, sync_s=sync_s), sync_s)
        state.take(messages.label(), float(second))
        times = {"answer_s": [(0.001, 0.003)] * 4, "heartbeat_s": [(0.4, 0.6)] * 4, "missing": [0] * 4}
        buses = [
            bus_state(each, load_ratio=0.625, nodes=[1, 2, 3, 4], nmt=bytes([5] * 4), **times)
            for each in (name, "right")
        ]
        state.take(gateway_status(buses=buses, sync_rate_hz=100.0), float(second))
    return state


def wrong(text: str = "refuses\nit") -> ViewState:
    """A skin with one fault of each part, whose texts are of others."""
    state = healthy()
    faults = {2: NodeFault("silent", text), 3: NodeFault("refused", text)}
    left = bus_state(text, nodes=[1, 2, 3], nmt=bytes([5, 255, 127]), faults=faults, other_sync=text)
    right = bus_state("right", nodes=[4], nmt=bytes([5]), link="bus_off", trouble=text)
    state.take(gateway_status(buses=[left, right]), 2.0)
    state.take(service_status(2, missed=7), 2.0)
    state.take(msgspec.structs.replace(Messages().label(), label=text), 2.0)
    state.take_peer(Peer("palm", "nodes", "2"), True, 0.0)
    state.take_peer(Peer("palm", "nodes", "2"), False, 2.0)
    return state


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("shown", SHOWN)
@pytest.mark.parametrize("text", ["short", "x" * 300, "\x1b[2J\x9b\r\n\t[red]触觉" * 9])
def test_every_line_is_within_the_terminal_and_shows_no_control_codes(
    text: str, shown: str, size: tuple[int, int]
) -> None:
    lines = drawn(wrong(text).snapshot(2.0)[0], shown, size)
    assert len(lines) == size[1]
    assert all(cell_len(line) <= size[0] and line.isprintable() for line in lines)


def test_a_small_terminal_shows_the_worst_first() -> None:
    lines = drawn(wrong().snapshot(2.0)[0], size=SIZES[0])
    assert lines[0].startswith(" palm   3 errors  ")
    assert lines[HEAD].startswith("error ")
    assert any("bus-off" in line for line in lines[HEAD:7])


def test_all_that_is_known_is_in_a_large_terminal() -> None:
    text = "\n".join(drawn(healthy().snapshot(2.0)[0]))
    clock = time.strftime("%H:%M:%S", time.localtime(1002.0))
    seen = (
        "palm +nothing is wrong +golf-ball 93% +.* N",
        f"{clock} +SYNC 100 Hz +10 images/s +5.0 ms, p99 5.0 ms +least 8/8 blocks",
        "left +█{6}░{4} +62% +0% +active +4 of 4 +0 +0 +0",
        "reconstructor +runs +1 MiB +50.0% +100.0/s +0 +[0-9:]{8} +realtime",
        "right +4 +1-3 ms +400-600 ms +0",
    )
    for each in seen:
        assert re.search(each, text), each


def test_the_figures_of_a_large_and_slow_skin_are_whole_at_80_columns() -> None:
    state = healthy().snapshot(2.0)[0]
    figures = msgspec.structs.replace(
        state.figures, images_hz=199.96, latency_p50_s=0.0123, latency_p99_s=0.0345, blocks=128, valid_blocks_low=127
    )
    gateway = msgspec.structs.replace(state.gateway, sync_rate_hz=199.91)
    line = drawn(msgspec.structs.replace(state, figures=figures, gateway=gateway), size=SIZES[0])[1]
    assert line.endswith("SYNC 200 Hz  200 images/s  12.3 ms, p99 34.5 ms  least 127/128 blocks")


def test_what_is_wrong_is_told_with_its_cause_its_begin_and_what_to_do() -> None:
    state = wrong().snapshot(2.0)[0]
    text, clock = "\n".join(drawn(state, "w")), time.strftime("%H:%M:%S", time.localtime(1002.0))
    for each in state.notices:
        assert each.code in text
        assert each.mend in text
    assert f"node-silent   {clock}  refuses\\nit" in text
    assert re.search("nodes +gone", text)
    assert "too slow" in text
    assert "1-3 ms" not in text  # of nodes that are whole
    assert drawn(healthy().snapshot(2.0)[0], "w")[HEAD] == "nothing is wrong"


def test_each_part_has_a_key_of_its_own() -> None:
    state = wrong().snapshot(2.0)[0]
    for shown, named in (("b", "load"), ("n", "not whole"), ("s", "service")):
        others = {"load", "not whole", "service"} - {named}
        headings = "\n".join(drawn(state, shown)[HEAD:-KEYS])
        assert named in headings
        assert not [each for each in others if f"{each} " in headings]


def test_before_the_first_message_and_without_the_hub_there_is_something_to_see() -> None:
    state = ViewState(Messages().layout, service="monitor")
    assert "gateway-absent" in "\n".join(drawn(state.snapshot(0.0)[0]))
    for is_there in (True, False):
        state.take_peer(Peer("palm", "monitor", "1"), is_there, 1.0)
    text = "\n".join(drawn(state.snapshot(9.0)[0]))
    assert "hub-away" in text
    assert "out of reach" in text


def test_moving_reaches_all_lines_and_ends_there() -> None:
    state = wrong("x" * 300).snapshot(2.0)[0]
    size, content = (80, 8), [text for text, _ in body(state, "a", 80)]
    room = size[1] - HEAD - KEYS
    for first in range(len(content) + 3):
        lines, at = screen(state, "a", size, first)
        assert at == min(first, len(content) - room)
        assert all(a.plain[:79] == b[:79] for a, b in zip(lines[HEAD:-KEYS], content[at:], strict=False))
    assert lines[-1].plain.endswith(f"{len(content) - room} above, 0 below")


def test_only_lines_that_change_are_drawn() -> None:
    state, out = healthy(), StringIO()
    size = [0, 0]  # as of a terminal that does not know its own
    console = Console(file=out, force_terminal=True, color_system="standard", legacy_windows=False)
    display = Display(console, lambda: (size[0], size[1]))

    def draw(*keys: bytes) -> str:
        out.seek(out.truncate(0))
        display.press(b"".join(keys))
        display.draw(state.snapshot(2.0)[0])
        return out.getvalue()

    assert "golf-ball" in draw()
    assert draw() == ""
    assert "golf-ball" not in draw(b"s")
    assert "left" in draw(b"s", b"/", b"n")
    assert draw(REDRAW).count(ERASED) == 24
    size[:] = 80, 3
    assert draw().count(ERASED) == 3
    assert "1 above" in draw(DOWN)
    assert "0 above" in draw(UP, UP)
    assert not display.is_over
    display.press(b"xq")
    assert display.is_over
