"""Plans as tables for a person."""

from collections.abc import Iterable, Sequence

from rich.console import Console, Group, RenderableType
from rich.table import Table

from bandwidth.alternatives import Alternative
from bandwidth.measured import BusLoad
from bandwidth.plan import BusPlan


def shown(what: RenderableType) -> str:
    """Return a table as text, as wide as the terminal or 120 columns."""
    console = Console(width=None if Console().is_terminal else 120, highlight=False)
    with console.capture() as capture:
        console.print(what)
    return capture.get().rstrip("\n")


def plan_tables(plans: Sequence[BusPlan], others: Iterable[Alternative]) -> RenderableType:
    """Return a plan: its buses side by side, the nodes' response times, the alternatives, the problems."""
    tried = list(others)
    notes = [f"does not fit: {problem}" for each in plans for problem in each.problems]
    notes += [f"{each.change} cannot be: {each.problem}" for each in tried if each.load_worst is None]
    responses = ["worst response of each node's last TPDO, ms:", *_node_lines(plans)]
    return Group(_bus_table(plans), "", *responses, "", _others(tried), *notes)


def load_table(loads: Sequence[BusLoad]) -> RenderableType:
    """Return measured loads beside the plan, and the fullest identifiers of each bus."""
    table = _table("", "", *(each.name for each in loads))
    rows = {
        "measured, s": [f"{each.seconds:.2f}" for each in loads],
        "frames": [str(each.frames) for each in loads],
        "load": [_percent(each.load_exact) for each in loads],
        "load planned": [_percent(each.plan_average) for each in loads],
        "load with most stuff bits": [_percent(each.load_worst) for each in loads],
        "load planned at worst": [_percent(each.plan_worst) for each in loads],
        "errors reported": [str(each.errors) for each in loads],
    }
    for name, cells in rows.items():
        table.add_row(name, *cells)
    return Group(table, *(_identifier_table(each) for each in loads))


def _identifier_table(load: BusLoad) -> Table:
    table = _table(load.name, "COB-ID", "what", "sender", "frames", "a second", "planned", "load", "at worst")
    for each in load.identifiers:
        planned = "-" if each.planned_rate_hz is None else f"{each.planned_rate_hz:.2f}"
        cob_id = f"{each.cob_id:0{8 if each.is_extended else 3}X}h"
        counts = (str(each.frames), f"{each.rate_hz:.2f}", planned)
        loads = (f"{each.load_exact:.3%}", f"{each.load_worst:.3%}")
        table.add_row(cob_id, each.kind, _sender(each.node_id), *counts, *loads)
    return table


def _bus_table(plans: Sequence[BusPlan]) -> Table:
    table = _table("", "", *(each.name for each in plans))
    rows = {
        "nodes": [str(each.nodes) for each in plans],
        "frames a cycle": [str(each.frames_per_cycle) for each in plans],
        "bits a cycle, average / worst": [
            f"{each.bits_per_cycle_average:.0f} / {each.bits_per_cycle_worst}" for each in plans
        ],
        "load, average / worst": [f"{_percent(each.load_average)} / {_percent(each.load_worst)}" for each in plans],
        "highest SYNC rate, average / worst, Hz": [
            f"{each.max_rate_hz_touched:.1f} / {each.max_rate_hz_worst:.1f}" for each in plans
        ],
        "the same with random bits, Hz": [f"{each.max_rate_hz_average:.1f}" for each in plans],
        "highest SYNC rate at 80 % of worst, Hz": [f"{each.max_rate_hz_worst_80:.1f}" for each in plans],
        "window (1007h), needed / set, ms": [f"{_ms(each.window_needed_ms)} / {each.window_ms:.2f}" for each in plans],
        "SDO response at worst, ms": [_ms(each.sdo_response_ms) for each in plans],
        "heartbeat at worst, ms": [_ms(each.heartbeat_response_ms) for each in plans],
        "receive buffer, frames / bytes": [
            f"{each.receive_buffer_frames} / {each.receive_buffer_bytes}" for each in plans
        ],
    }
    for name, cells in rows.items():
        table.add_row(name, *cells)
    return table


def _others(others: Iterable[Alternative]) -> Table:
    table = _table(
        "", "with", "nodes", "frames", "rounding, mN", "load, random / worst", "Hz, random / worst", "window, ms"
    )
    for each in others:
        if each.load_random is None or each.load_worst is None or each.rounding_error_n is None:
            table.add_row(each.change, str(each.nodes), "-", "-", "cannot be", "-", "-")
            continue
        table.add_row(
            each.change,
            str(each.nodes),
            str(each.frames_per_cycle),
            f"{each.rounding_error_n * 1e3:.2f}",
            f"{_percent(each.load_random)} / {_percent(each.load_worst)}",
            f"{each.max_rate_hz_average:.1f} / {each.max_rate_hz_worst:.1f}",
            _ms(each.window_needed_ms),
        )
    return table


def _node_lines(plans: Sequence[BusPlan]) -> list[str]:
    """Return the response times of every bus; buses whose nodes have the same share a line."""
    alike: dict[str, list[str]] = {}
    for each in plans:
        responses = ", ".join(f"{node.node_id}: {_ms(node.response_ms)}" for node in each.node_plans)
        alike.setdefault(responses, []).append(each.name)
    return [f"  {', '.join(names)}: {responses}" for responses, names in alike.items()]


def _table(title: str, *headers: str) -> Table:
    table = Table(title=title or None, title_justify="left", box=None, pad_edge=False)
    for place, header in enumerate(headers):
        table.add_column(header, justify="left" if place == 0 else "right")
    return table


def _sender(node_id: int | None) -> str:
    return "-" if node_id is None else str(node_id) if node_id else "gateway"


def _ms(value: float | None) -> str:
    return "none" if value is None else f"{value:.2f}"


def _percent(value: float) -> str:
    return f"{value:.1%}"
