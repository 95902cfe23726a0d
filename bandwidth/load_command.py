"""``skin load``: the load that was measured, beside the one that was planned."""

from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter

from bandwidth.logs import listen, of_buses, read_log
from bandwidth.measured import BusLoad, measure
from bandwidth.plan import plan
from bus.options import BusOptions, channels, open_links
from dbc.contract import Contract
from skin.errors import InputError, RunError
from skin.layout import load_layout
from skin.service import StopSignal, say


def load(
    log: Path | None = None,
    *,
    layout: Path | None = None,
    can: BusOptions | None = None,
    seconds: float = 5.0,
    json_: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> None:
    """Measure the load of the buses of a skin, per node and identifier, from a log or live.

    Counts the real stuff bits of every frame of whole cycles, CAN FD included, and the most there could be.

    Parameters
    ----------
    log
        Log of candump (-l), ASC, BLF, MF4 or any other that python-can reads; without it the buses are listened to.
    layout
        TOML of the skin; without it the default skin.
    can
        Live: the CAN interfaces. Of a log: its channels, by default the buses' names, else all in their order.
    seconds
        Live: how long to listen.
    json_
        Print one JSON object.

    Examples
    --------
    skin load candump-2026-11-20_120000.log
    skin load -i socketcan -c can0 --seconds 10 --json
    """
    if not 0 < seconds < float("inf"):
        raise InputError(f"expected a finite number of seconds above 0, got {seconds:g}")
    contract = Contract.from_layout(load_layout(layout))
    options = can or BusOptions()
    if log is not None:
        seen = of_buses(
            contract.layout, channels(contract.layout, options), read_log(log), log, named_by_user=bool(options.channel)
        )
    else:
        stop = StopSignal().install()
        links = open_links(contract.layout, options, name="load")
        try:
            say("load", f"listening for {seconds:g} s")
            seen = listen(links, seconds, stop.is_set)
            dropped = sum(link.dropped for link in links.values())
        finally:
            for link in links.values():
                link.close()
        if dropped:
            raise RunError(f"{dropped} frames were lost on the way to this program: the load would be too low")
    plans = plan(contract)
    loads = [measure(contract, number, frames, plans[number]) for number, frames in seen.items()]
    _show(loads, as_json=json_)


def _show(loads: list[BusLoad], *, as_json: bool) -> None:
    if as_json:
        print(msgspec.json.encode({"buses": loads}).decode())
        return
    from bandwidth.tables import load_table, shown

    print(shown(load_table(loads)))
