"""``skin commission``: gives the boards of a skin their node-IDs by LSS, and their configuration by SDO."""

import time
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from bus.link import Link, open_link
from bus.options import BusOptions, channels, closing_links, open_links
from canskin.errors import InputError
from commissioning.board_steps import Commissioning
from commissioning.serial_commissioning import SerialCommissioning
from commissioning.talk import take_turn
from commissioning.touch_commissioning import TouchCommissioning, require_patches
from dbc.canopen import LSS_BIT_RATES_HZ
from dbc.contract import Contract
from shell.service import StopSignal, say
from shell.terminal import Json, print_json, print_table
from skin.layout import Layout, load_layout


def commission(
    *,
    layout: Path | None = None,
    can: BusOptions | None = None,
    bitrate: int | None = None,
    renumber: Annotated[bool, Parameter(negative=())] = False,
    touch: Annotated[bool, Parameter(negative=())] = False,
    json: Json = False,
) -> int:
    """Give the boards of a skin their node-IDs, bit rate and configuration, and print which board is where.

    A board is known by vendor-ID, product code and serial number (1018h; ``[device]`` of the layout). LSS (CiA 305)
    finds boards without node-ID; while a board is in work, its LED flickers (CiA 303-3, LSS configuration). What the
    gateway proves is compared, written and stored (1010h). Boards that are complete are left as they are, so that a
    run that was stopped goes on. No gateway may run. Ends with 1 if a board is not complete, or a stranger is there.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    can
        CAN interface and channels.
    bitrate
        Bit rate that the boards have now, bit/s, where it is not that of the layout: the boards get the layout's, which
        counts from their next power-up on. Then run the command again without this option. SocketCAN has its own bit
        rate: set it first.
    renumber
        Give a board that has another node-ID than the layout's the right one.
    touch
        Serial numbers tell no places: the command asks for a touch on one block after the other, and gives the board
        that feels it the node-ID of the block. The board's LED flickers until the finger is lifted. Ctrl-C keeps what
        was touched.
    json
        Print one JSON object.

    Examples
    --------
    skin commission --layout palm.toml -i socketcan -c can0
    skin commission --layout palm.toml -i socketcan -c can0 --bitrate 125000
    skin commission --layout palm.toml -i socketcan -c can0 --touch
    """
    skin, options, stop = load_layout(layout), can or BusOptions(), StopSignal().install()
    contract = Contract.from_layout(skin)
    if touch and renumber:
        raise InputError("expected --touch or --renumber: after a touch a serial number tells no place")
    if touch:
        require_patches(contract)

    def new_run(bus: int, link: Link) -> Commissioning:
        now_s = time.monotonic()
        if touch:
            return TouchCommissioning(contract, bus, link.send, now_s, say=_tell, bit_rate_hz=bitrate)
        return SerialCommissioning(contract, bus, link.send, now_s, bit_rate_hz=bitrate, renumber=renumber)

    runs: dict[int, Commissioning] = {}
    with closing_links(_opened(skin, options, bitrate, stop)) as links:
        # A finger touches one bus after the other.
        for together in [{bus: link} for bus, link in links.items()] if touch else [links]:
            begun = {bus: new_run(bus, link) for bus, link in together.items()}
            runs |= begun
            _run(contract, together, begun, stop)
    found = [_about(contract, bus, each) for bus, each in runs.items()]
    if json:
        print_json(found)
    else:
        for each in found:
            _show(each)
    return int(not all(each.is_whole for each in runs.values()))


def _opened(skin: Layout, options: BusOptions, bit_rate_hz: int | None, stop: StopSignal) -> dict[int, Link]:
    """Open the links of all buses, at the bit rate that the boards have now."""
    if bit_rate_hz is None:
        return open_links(skin, options, name="commission", stop=stop)
    known = [each for each in LSS_BIT_RATES_HZ if each]
    for rate in (bit_rate_hz, *(line.bitrate for line in skin.bus)):
        if rate not in known:
            raise InputError(f"--bitrate: LSS changes between {', '.join(map(str, known))} bit/s, got {rate}")
    names = channels(skin, options)
    return {bus: open_link(options.interface, name, bit_rate_hz, name="commission") for bus, name in enumerate(names)}


def _tell(line: str) -> None:
    say("commission", line)


def _run(contract: Contract, links: dict[int, Link], runs: dict[int, Commissioning], stop: StopSignal) -> None:
    """Commission all buses at the same time; say how far each board has come."""
    said: dict[tuple[int, int], str] = {}
    try:
        while not all(each.done for each in runs.values()) and not stop.is_set():
            take_turn(links, runs)
            for bus, run in runs.items():
                for node_id, board in run.boards.items():
                    if board.is_begun and said.get((bus, node_id)) != board.text:
                        said[bus, node_id] = board.text
                        say("commission", f"{contract.layout.bus[bus].name}, node {node_id}: {board.text}")
    finally:
        for each in runs.values():
            if not each.done:
                each.give_up()


def _about(contract: Contract, bus: int, run: Commissioning) -> dict[str, Any]:
    boards = [
        {
            "node_id": node_id,
            "block": board.node.block,
            "blocks": board.node.blocks,
            "serial_number": board.serial,
            "complete": board.is_complete,
            "text": board.text,
        }
        for node_id, board in run.boards.items()
    ]
    name = contract.layout.bus[bus].name
    return {"bus": name, "boards": boards, "strangers": run.strangers, "error_frames": run.error_frames}


def _show(found: dict[str, Any]) -> None:
    rows = [
        [each["node_id"], each["block"], each["serial_number"], "yes" if each["complete"] else "NO", each["text"]]
        for each in found["boards"]
    ]
    print_table(["node", "block", "serial", "complete", "what"], rows, title=found["bus"])
    for text in found["strangers"]:
        print(f"{found['bus']}: {text}")
    if found["error_frames"]:
        print(f"{found['bus']}: {found['error_frames']} error frames: bit rate (--bitrate), wiring, or no board?")
    complete = sum(each["complete"] for each in found["boards"])
    print(f"{found['bus']}: {complete} of {len(found['boards'])} boards are complete")
