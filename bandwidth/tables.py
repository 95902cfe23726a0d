"""Tables of plans and of measured loads."""

import textwrap
from collections.abc import Iterable, Sequence
from typing import Final

from bandwidth.alternatives import Alternative
from bandwidth.measured import BusLoad
from bandwidth.plan import BusPlan
from skin.terminal import print_table

#: Columns of the lines that list the nodes of a bus.
_WIDTH: Final = 120
#: A space without line break.
_NO_BREAK: Final = "\N{NO-BREAK SPACE}"


def print_plan(plans: Sequence[BusPlan], others: Iterable[Alternative]) -> None:
    """Print a plan: a column per bus, the nodes' response times, the alternatives, the problems."""
    tried = list(others)
    _print_buses(plans)
    print("\nworst response of each node's last TPDO, ms:")
    for line in _node_lines(plans):
        print(textwrap.fill(line, _WIDTH, initial_indent="  ", subsequent_indent="    ").replace(_NO_BREAK, " "))
    print()
    _print_alternatives(tried)
    for plan in plans:
        for problem in plan.problems:
            print(f"does not fit: {problem}")
    for each in tried:
        if each.load_worst is None:
            print(f"{each.change} cannot be: {each.problem}")


def print_loads(loads: Sequence[BusLoad]) -> None:
    """Print measured loads beside the plan, and every identifier of each bus."""
    rows: list[list[object]] = [
        ["measured, s", *(f"{each.seconds:.2f}" for each in loads)],
        ["frames", *(each.frames for each in loads)],
        ["load", *(_percent(each.load_exact) for each in loads)],
        ["load planned, touched", *(_percent(each.plan_touched) for each in loads)],
        ["load with most stuff bits", *(_percent(each.load_worst) for each in loads)],
        ["load planned, worst", *(_percent(each.plan_worst) for each in loads)],
        ["errors reported", *(each.errors for each in loads)],
    ]
    print_table(["", *(each.name for each in loads)], rows)
    for each in loads:
        print()
        _print_identifiers(each)


def _print_identifiers(load: BusLoad) -> None:
    rows = [
        [
            each.name,
            each.kind,
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


def _print_buses(plans: Sequence[BusPlan]) -> None:
    rows = {
        "nodes": [str(each.nodes) for each in plans],
        "frames a cycle": [str(each.frames_per_cycle) for each in plans],
        "bits a cycle, touched / worst": [
            f"{_number(each.bits_per_cycle_touched, 0)} / {each.bits_per_cycle_worst}" for each in plans
        ],
        "load, touched / worst": [f"{_percent(each.load_touched)} / {_percent(each.load_worst)}" for each in plans],
        "highest SYNC rate, touched / worst, Hz": [
            f"{_number(each.max_rate_hz_touched, 1)} / {each.max_rate_hz_worst:.1f}" for each in plans
        ],
        "highest SYNC rate, random bits, Hz": [f"{each.max_rate_hz_random:.1f}" for each in plans],
        "highest SYNC rate at a worst load of 80 %, Hz": [f"{each.max_rate_hz_worst_80:.1f}" for each in plans],
        "window (1007h), needed / set, ms": [f"{_ms(each.window_needed_ms)} / {each.window_ms:.2f}" for each in plans],
        "SDO response at worst, ms": [_ms(each.sdo_response_ms) for each in plans],
        "heartbeat at worst, ms": [_ms(each.heartbeat_response_ms) for each in plans],
        "receive buffer, frames / bytes": [
            f"{each.receive_buffer_frames} / {each.receive_buffer_bytes}" for each in plans
        ],
    }
    print_table(["", *(each.name for each in plans)], [[name, *cells] for name, cells in rows.items()])


def _print_alternatives(others: Iterable[Alternative]) -> None:
    rows = []
    for each in others:
        if each.load_random is None or each.load_worst is None or each.rounding_error_n is None:
            rows.append([each.change, str(each.nodes), "-", "-", "cannot be", "-", "-"])
            continue
        rows.append(
            [
                each.change,
                str(each.nodes),
                str(each.frames_per_cycle),
                f"{each.rounding_error_n * 1e3:.2f}",
                f"{_percent(each.load_random)} / {_percent(each.load_worst)}",
                f"{_number(each.max_rate_hz_random, 1)} / {_number(each.max_rate_hz_worst, 1)}",
                _ms(each.window_needed_ms),
            ]
        )
    headings = ["with", "nodes", "frames", "rounding, mN", "load, random / worst", "Hz, random / worst", "window, ms"]
    print_table(headings, rows)


def _node_lines(plans: Sequence[BusPlan]) -> list[str]:
    """Return lines with the response times of every bus; buses with equal times share a line."""
    alike: dict[str, list[str]] = {}
    for each in plans:
        responses = ", ".join(f"{node.node_id}:{_NO_BREAK}{_ms(node.response_ms)}" for node in each.node_plans)
        alike.setdefault(responses, []).append(each.name)
    return [f"{', '.join(names)}: {responses}" for responses, names in alike.items()]


def _sender(node_id: int | None) -> str:
    return "-" if node_id is None else str(node_id) if node_id else "gateway"


def _ms(value: float | None) -> str:
    return "none" if value is None else f"{value:.2f}"


def _number(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1%}"
