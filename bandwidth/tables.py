"""Tables of plans and of measured loads."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from bandwidth.measured import BusLoad
from bandwidth.plan import BusPlan
from dbc.canopen import identifier_text
from shell.terminal import print_table

#: Columns of the lines that list the nodes of a bus.
_WIDTH: Final = 120
#: A space without line break.
_NO_BREAK: Final = "\N{NO-BREAK SPACE}"


def print_plan(plans: Sequence[BusPlan]) -> None:
    """Print a plan: a column per bus, the nodes' response times, the problems."""
    print_buses(plans)
    print("\nworst response of each node's last TPDO, ms:")
    times = {each.name: [(node.node_id, node.response_ms) for node in each.node_plans] for each in plans}
    _print_wrapped(_node_lines(times))
    _print_foreign(plans)
    print_problems(plans)


def print_loads(loads: Sequence[BusLoad]) -> None:
    """Print measured loads beside the plan, and every identifier of each bus."""
    _print_measured(loads)
    for each in loads:
        print()
        _print_identifiers(each)


def _print_measured(loads: Sequence[BusLoad]) -> None:
    rows: list[list[object]] = [
        ["measured, s", *(f"{each.seconds:.2f}" for each in loads)],
        ["frames", *(each.frames for each in loads)],
        ["load", *(percent(each.load_exact) for each in loads)],
        ["load planned, touched", *(percent(each.plan_touched) for each in loads)],
        ["load with most stuff bits", *(percent(each.load_worst) for each in loads)],
        ["load planned, worst", *(percent(each.plan_worst) for each in loads)],
        ["errors reported", *(each.errors for each in loads)],
    ]
    print_table(["", *(each.name for each in loads)], rows)


def _print_identifiers(load: BusLoad) -> None:
    rows = [
        [
            each.name,
            each.message or each.kind,
            _sender(each.node_id),
            each.frames,
            f"{each.rate_hz:.2f}",
            "-" if each.planned_rate_hz is None else f"{each.planned_rate_hz:.2f}",
            f"{each.load_exact:.3%}",
            f"{each.load_worst:.3%}",
        ]
        for each in load.identifiers
    ]
    headings = ["COB-ID", "kind", "sender", "frames", "a second", "planned", "load", "worst load"]
    print_table(headings, rows, title=load.name)


def _print_foreign(plans: Sequence[BusPlan]) -> None:
    """Print the messages of other devices, and how long the skin may delay them."""
    rows = [
        [
            plan.name,
            each.name,
            identifier_text(each.identifier, is_extended=each.is_extended),
            f"{each.period_ms:g}",
            ms(each.response_ms),
        ]
        for plan in plans
        for each in plan.foreign
    ]
    if rows:
        print()
        print_table(["bus", "message of another device", "COB-ID", "period, ms", "end at worst, ms"], rows)


def print_problems(plans: Sequence[BusPlan]) -> None:
    """Print why buses do not fit."""
    for plan in plans:
        for problem in plan.problems:
            print(f"does not fit: {problem}")


def print_buses(plans: Sequence[BusPlan]) -> None:
    """Print the figures of the buses, a column each."""
    rows = {
        "nodes": [str(each.nodes) for each in plans],
        "frames a cycle": [str(each.frames_per_cycle) for each in plans],
        "bits a cycle, touched / worst": [
            f"{number(each.bits_per_cycle_touched, 0)} / {each.bits_per_cycle_worst}" for each in plans
        ],
        "load, touched / worst": [f"{percent(each.load_touched)} / {percent(each.load_worst)}" for each in plans],
        "highest SYNC rate, touched / worst, Hz": [
            f"{number(each.max_rate_hz_touched, 1)} / {each.max_rate_hz_worst:.1f}" for each in plans
        ],
        "highest SYNC rate, random bits, Hz": [f"{each.max_rate_hz_random:.1f}" for each in plans],
        "highest SYNC rate at a worst load of 80 %, Hz": [f"{each.max_rate_hz_worst_80:.1f}" for each in plans],
        "window (1007h), needed / set, ms": [f"{ms(each.window_needed_ms)} / {each.window_ms:.2f}" for each in plans],
        "SDO response at worst, ms": [ms(each.sdo_response_ms) for each in plans],
        "heartbeat at worst, ms": [ms(each.heartbeat_response_ms) for each in plans],
        "receive buffer, frames / bytes": [
            f"{each.receive_buffer_frames} / {each.receive_buffer_bytes}" for each in plans
        ],
    }
    print_table(["", *(each.name for each in plans)], [[name, *cells] for name, cells in rows.items()])


def _node_lines(buses: Mapping[str, Sequence[tuple[int, float | None]]]) -> list[str]:
    """Return lines with node-IDs and times of every bus, by its name; buses with equal times share a line."""
    alike: dict[str, list[str]] = {}
    for name, times in buses.items():
        responses = ", ".join(f"{node_id}:{_NO_BREAK}{ms(time_ms)}" for node_id, time_ms in times)
        alike.setdefault(responses, []).append(name)
    return [f"{', '.join(names)}: {responses}" for responses, names in alike.items()]


def _print_wrapped(lines: Iterable[str]) -> None:
    """Print long lines, indented and wrapped between nodes."""
    for line in lines:
        print(textwrap.fill(line, _WIDTH, initial_indent="  ", subsequent_indent="    ").replace(_NO_BREAK, " "))


def _sender(node_id: int | None) -> str:
    return "-" if node_id is None else str(node_id) if node_id else "gateway"


def ms(value: float | None) -> str:
    """Return milliseconds, or none."""
    return "none" if value is None else f"{value:.2f}"


def number(value: float | None, digits: int) -> str:
    """Return a number with `digits` decimals, or a dash."""
    return "-" if value is None else f"{value:.{digits}f}"


def percent(value: float | None) -> str:
    """Return a share in percent, or a dash."""
    return "-" if value is None else f"{value:.1%}"


def print_slot_plan(plans: Sequence[BusPlan]) -> None:
    """Print a plan of stepped boards: a column per bus, the nodes' response times, the problems."""
    full = [each.name for each in plans if each.load_worst > 1 and not each.problems]
    how = ", random bits," if full else " at worst,"
    rows = {
        "nodes": [str(each.nodes) for each in plans],
        "slot, ms": [f"{each.window_ms:.2f}" for each in plans],
        "load, at rest / touched": [f"{percent(each.load_rest)} / {percent(each.load_touched)}" for each in plans],
        "load of all slots, random bits / worst": [
            f"{percent(each.load_random)} / {percent(each.load_worst)}" for each in plans
        ],
        "shortest slot for all boards, random bits / worst, ms": [
            f"{_slot_ms(each.max_rate_hz_random)} / {_slot_ms(each.max_rate_hz_worst)}" for each in plans
        ],
        "sample to end of frame, random bits / worst, ms": [
            f"{ms(each.late_random_ms)} / {ms(each.window_needed_ms)}" for each in plans
        ],
        f"SDO response{how} ms": [ms(each.sdo_response_ms) for each in plans],
        f"heartbeat{how} ms": [ms(each.heartbeat_response_ms) for each in plans],
        "receive buffer, frames / bytes": [
            f"{each.receive_buffer_frames} / {each.receive_buffer_bytes}" for each in plans
        ],
    }
    print_table(["", *(each.name for each in plans)], [[name, *cells] for name, cells in rows.items()])
    print("\nsample to end of frame of each node while all boards send, at worst, ms:")
    _print_wrapped(
        _node_lines({each.name: [(node.node_id, node.response_ms) for node in each.node_plans] for each in plans})
    )
    if full:
        print(
            f"\nwhile all boards of {', '.join(full)} send, boards may leave slots out, those with high node-IDs first"
        )
    _print_foreign(plans)
    print_problems(plans)


def _slot_ms(rate_hz: float) -> str:
    return ms(1e3 / rate_hz if rate_hz else None)
