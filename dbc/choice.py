"""A choice of nodes by texts such as ``bus0:5`` and ``bus2:1-16``."""

import re
from collections.abc import Collection

from canskin.errors import InputError
from dbc.contract import Contract
from skin.ranges import listed, ranges_text


def choose_nodes(contract: Contract, only: list[str], without: list[str]) -> dict[int, Collection[int]]:
    """Return the node-IDs to run, by number of the bus; buses without nodes to run are left out.

    Raise InputError if a choice names a bus or node that the layout does not have, or no node is left.
    """
    chosen = _parse(contract, only) if only else {(node.bus, node.node_id) for node in contract.nodes}
    chosen -= _parse(contract, without)
    if not chosen:
        raise InputError("no node is left to run: check --only and --without")
    return {bus: {node for each, node in chosen if each == bus} for bus in {bus for bus, _ in chosen}}


def _parse(contract: Contract, texts: list[str]) -> set[tuple[int, int]]:
    numbers = {bus.name: number for number, bus in enumerate(contract.layout.bus)}
    known = {(node.bus, node.node_id) for node in contract.nodes}
    chosen: set[tuple[int, int]] = set()
    for text in listed(texts):
        match = re.fullmatch(r"(\w+):(\d+)(?:-(\d+))?", text)
        if match is None or match[1] not in numbers:
            raise InputError(f"expected BUS:NODE or BUS:FIRST-LAST with BUS of {', '.join(numbers)}, got '{text}'")
        wanted = {(numbers[match[1]], node) for node in range(int(match[2]), int(match[3] or match[2]) + 1)}
        if not wanted or wanted - known:
            there = ranges_text(node for bus, node in known if bus == numbers[match[1]])
            raise InputError(f"expected nodes of {match[1]}, {there}, got '{text}'")
        chosen |= wanted
    return chosen
