"""``skin load``: measured load beside planned load, and the differences between a bus and its plan."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from bandwidth.departures import departures
from bandwidth.logs import listen, of_buses, read_log
from bandwidth.measured import measure, misfits
from bandwidth.plan import plan
from bandwidth.tables import print_loads
from bus.options import BusOptions, channels, closing_links, open_links
from canskin.errors import RunError
from dbc.contract import Contract
from dbc.frame import Frames
from shell.service import StopSignal, say
from shell.skin_options import SkinOptions
from shell.terminal import Json, print_json
from skin.layout import Layout
from skin.ranges import require_above_zero


def load(
    log: Path | None = None,
    *,
    of: SkinOptions | None = None,
    can: BusOptions | None = None,
    seconds: float = 5.0,
    check: Annotated[bool, Parameter(negative=())] = False,
    json_: Json = False,
) -> int:
    """Measure the load of the buses of a skin, per node and identifier, from a log or live.

    Counts the stuff bits of every frame in whole cycles, CAN FD included, and the most possible stuff bits. A line on
    standard error tells if the frames do not fit the layout. Exit code 1: with ``--check`` a bus differs from its plan.

    Parameters
    ----------
    log
        A recording (.mcap), or a log of candump (-l), ASC, BLF, MF4 or any other format that python-can reads; default:
        measure the live buses.
    of
        Which skin. Without an option the layout is that of the recording (.mcap); live that of a hub of this machine;
        else the default one.
    can
        Live: the CAN interfaces. In a log: the channel of each bus. Default: the names of the buses, else all
        channels in their order.
    seconds
        Live: time of the measurement.
    check
        Print each difference between the buses and their plan, in place of the loads: frames that are missing, late,
        repeated, wrong or not planned.
    json_
        Print one JSON object.

    Examples
    --------
    skin load candump-2026-11-20_120000.log
    skin load candump-2026-11-20_120000.log --layout palm.toml --check
    skin load -i socketcan -c can0 --seconds 10 --json
    """
    require_above_zero("--seconds", seconds)
    skin = (of or SkinOptions()).find(recording=log, needs_hub=False)
    contract, options = Contract.from_layout(skin), can or BusOptions()
    if log is None:
        seen = _listen(skin, options, seconds)
    else:
        names = channels(skin, options)
        logged = read_log(log, lambda line: say("load", line))
        seen = of_buses(skin, names, logged, log, named_by_user=bool(options.channel))
    plans = plan(contract, is_touched=not check)
    loads, lines = [], []
    for number, frames in seen.items():
        loads.append(measure(contract, number, frames, plans[number]))
        for line in misfits(contract, number, frames, loads[-1]):
            say("load", line)
        lines += departures(contract, number, frames, plans[number], loads[-1]) if check else []
    if json_:
        print_json({"differences": lines} if check else {"buses": loads})
    elif not check:
        print_loads(loads)
    elif lines:
        print("\n".join(lines))
    return int(bool(lines))


def _listen(layout: Layout, options: BusOptions, seconds: float) -> dict[int, Frames]:
    """Return the frames of the live buses; a stop signal before the measurement ends the program."""
    with closing_links(open_links(layout, options, name="load", sends=False)) as links:
        stop = StopSignal().install()
        say("load", f"listening for {seconds:g} s")
        seen = listen(links, seconds, stop.is_set)
        dropped = sum(link.dropped for link in links.values())
    if dropped:
        raise RunError(f"{dropped} frames were lost on the way to this program: the load would be too low")
    return seen
