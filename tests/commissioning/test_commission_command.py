"""What ``skin commission`` prints, and how it ends."""

import json
from collections.abc import Callable, Mapping

import pytest

from bus.link import Link
from canskin.errors import InputError, LayoutError
from commissioning import commission_command
from commissioning.board_steps import Commissioning
from dbc.contract import Contract
from dbc.frame import ERROR
from shell.service import StopSignal
from tests.bus.harness import frame
from tests.commissioning.fresh_boards import Bench, DiesBeforeStoring, skin

Command = Callable[..., tuple[int, str]]


@pytest.fixture
def on(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[[Bench], Command]:
    """Return the command on a bench: exit code, and what it prints on both streams."""

    def on_bench(bench: Bench) -> Command:
        class Wire:
            send = bench.send

            def close(self) -> None: ...

        def run(_: Contract, links: Mapping[int, Link], runs: Mapping[int, Commissioning], stop: StopSignal) -> None:
            del links, stop
            for each in runs.values():
                bench.run(each)

        monkeypatch.setattr(commission_command, "_opened", lambda *_: {0: Wire()})
        monkeypatch.setattr(commission_command, "load_layout", lambda _: bench.contract.layout)
        monkeypatch.setattr(commission_command, "_run", run)
        monkeypatch.setattr(commission_command.time, "monotonic", lambda: bench.now_s)

        def command(**options: object) -> tuple[int, str]:
            code = commission_command.commission(**options)  # type: ignore[arg-type]
            told = capsys.readouterr()
            return code, told.out + told.err

        return command

    return on_bench


def test_the_map_is_printed_and_a_whole_bus_ends_with_0(on: Callable[[Bench], Command]) -> None:
    bench = Bench(skin(2))
    for node_id in (1, 2):
        bench.add(node_id)
    command = on(bench)
    code, text = command()
    assert code == 0
    assert [line.split() for line in text.splitlines()] == [
        ["bus0"],
        ["node", "block", "serial", "complete", "what"],
        ["1", "0", "1", "yes", "complete"],
        ["2", "1", "2", "yes", "complete"],
        ["bus0:", "2", "of", "2", "boards", "are", "complete"],
    ]
    code, text = command(json=True)
    (bus,) = json.loads(text)
    assert (code, bus["bus"], bus["strangers"], bus["error_frames"]) == (0, "bus0", [], 0)
    assert [each["node_id"] for each in bus["boards"] if each["complete"]] == [1, 2]


def test_every_trouble_has_its_name_and_ends_with_1(on: Callable[[Bench], Command]) -> None:
    contract = skin(6)
    bench = Bench(contract)
    bench.add(1)
    bench.add(2, numbered=True)
    bench.add(2, contract=skin(6, device={"first_serial": 50}), numbered=True)
    bench.add(3, contract=skin(6, device={"vendor_id": 0x55}), numbered=True)
    bench.add(4)
    bench.add(4)
    bench.add(5).lives = DiesBeforeStoring(5)
    bench.add(1, contract=skin(6, device={"first_serial": 1000}))
    code, text = on(bench)()
    assert code == 1
    for said in (
        "NO        two boards answer: they have node-ID 2",
        "NO        has vendor-ID 55h, product code 534B494Eh: not a board of this skin",
        "NO        two boards answer: they have one serial number",
        "NO        stopped answering at the storage of its node-ID (so far: has node-ID 5 until its power is cut)",
        "NO        not found: is the board powered, on this bus, at this bit rate, with LSS?",
        "bus0: a board without node-ID, vendor-ID 0h, product code 534B494Eh, serial number 1000: not a board of this",
        "bus0: 1 of 6 boards are complete",
    ):
        assert said in text, text


def test_boards_at_another_bit_rate_are_told_by_error_frames(on: Callable[[Bench], Command]) -> None:
    bench = Bench(skin(2))
    command = on(bench)
    bench.noise = frame(0, b"", flags=ERROR)
    code, text = command()
    assert code == 1
    assert "error frames: bit rate (--bitrate), wiring, or no board?" in text
    bench.noise = bench.noise[:0]
    bench.add(1)
    code, text = command(bitrate=125_000)
    assert code == 1
    assert "has stored its node-ID, and 1000000 bit/s from its next power-up on" in text


def test_wrong_options_are_refused(on: Callable[[Bench], Command]) -> None:
    command = on(Bench(skin(2)))
    with pytest.raises(InputError, match="--touch or --renumber"):
        command(touch=True, renumber=True)
    with pytest.raises(LayoutError, match="do not lie together"):
        command(touch=True)


def test_a_bit_rate_that_lss_does_not_know_is_refused() -> None:
    with pytest.raises(InputError, match=r"--bitrate: LSS changes between 1000000, .* got 123456"):
        commission_command.commission(bitrate=123_456)
