"""Small layouts, skins whose sums come in turns (`sync.turns`), and the default skin in one instant."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import tomli_w

from canskin.errors import LayoutError
from dbc.contract import Contract
from skin import layouts
from skin.layout import Layout, changed, layout_text, load_layout, parse_layout

#: Names of the layouts that come with the project.
SHIPPED: Final = sorted(path.stem for path in Path(layouts.__path__[0]).glob("*.toml"))
#: Tables of stepped boards.
STEPPED: Final = {"sending": "steps", "measurement": {"wiring": "board"}}
#: The stepped skin of 64 x 64 taxels that comes with the project.
STEPPED_SKIN: Final = load_layout(Path("steps"))
#: Sums, groups and TPDOs of a board of `STEPPED_SKIN`, and nodes of its buses.
BLOCK_SUMS, GROUPS, TPDOS, NODES = 32, 4, 32, 32
#: A skin of three patches: 12 x 14 with gaps, 132 taxels.
TWO_FINGERS: Final = [*["######..######"] * 6, "." * 14, *["############.."] * 5]
#: Values of `sync.turns`.
TURNS: Final = (1, 2)


def layout_toml(rows: int = 8, columns: int = 8, **tables: Any) -> str:
    """Return the text of a layout of `rows` by `columns` taxels.

    `tables` are those of the file. Without `bus` each block of 32 taxels is a node, up to 32 nodes are a bus, and the
    buses are called bus0, bus1 and so on. In cycles a block sends a quarter of its sums, of one sample of each taxel,
    unless `tables` say otherwise.
    """
    size = {"rows": rows, "columns": columns}
    return tomli_w.dumps(plain({**tables, "taxels": size | tables.get("taxels", {})}))


def plain(tables: dict[str, Any]) -> dict[str, Any]:
    """Return the tables of a file with a quarter of the sums of each block, and one sample a SYNC, where not given."""
    measurement = tables.get("measurement", {})
    if tables.get("sending") == "steps" or "matrix" in measurement:
        return tables
    try:
        bare = parse_layout(tomli_w.dumps(tables).encode(), "small.toml")
    except LayoutError:  # what the test is about
        return tables
    sampled = {"sampling": {"rate_hz": bare.sync.rate_hz}}
    if "rows" in measurement:
        return sampled | tables
    of_block = max(1, bare.measurement.block_size // 4)
    return sampled | tables | {"measurement": {"sums": bare.blocks * of_block} | measurement}


def small_layout(rows: int = 8, columns: int = 8, **tables: Any) -> Layout:
    """Return the layout of `layout_toml`."""
    return parse_layout(layout_toml(rows, columns, **tables).encode(), "small.toml")


def any_layout(rows: int, columns: int, **tables: Any) -> Layout:
    """Return the layout of a file with these tables: what is not given is chosen."""
    return parse_layout(tomli_w.dumps({"taxels": {"rows": rows, "columns": columns}, **tables}).encode(), "any.toml")


def tube_layout(rings: int = 8, around: int = 12, **tables: Any) -> Layout:
    """Return a skin that is no grid: half a tube of 20 mm radius around z, `rings` times `around` taxels.

    Taxel 0 is at the largest x of the ring at z = 0; the outside faces y.
    """
    ring, step = np.divmod(np.arange(rings * around), around)
    angle = np.pi * (step + 0.5) / around
    normals = np.stack((np.cos(angle), np.sin(angle), np.zeros(angle.size)), axis=1)
    places_m = np.c_[normals * 0.02 + np.outer(ring, (0.0, 0.0, 0.005)), normals]
    tables = {"name": "tube", **tables, "taxels": {"positions": places_m.tolist(), **tables.get("taxels", {})}}
    return parse_layout(tomli_w.dumps(plain(tables)).encode(), "tube.toml")


def small_contract(rate_hz: float = 20.0, turns: int = 1, **tables: Any) -> Contract:
    """Return the contract of two buses of two nodes; each has 32 taxels, and eight sums in two frames."""
    sync = {"rate_hz": rate_hz, "turns": turns}
    return Contract.from_layout(small_layout(8, 16, **{"name": "small", "sync": sync, "bus": buses(2, 2)} | tables))


def small_boards(taxels: int, rows: int = 16, columns: int = 16, **bus: Any) -> Layout:
    """Return a skin of stepped boards of `taxels` on one bus, which has the keys `bus`."""
    measurement = STEPPED["measurement"] | {"block_size": taxels}
    nodes = -(-rows * columns // taxels)
    return small_layout(rows, columns, **STEPPED | {"measurement": measurement}, bus=buses(nodes, **bus))


def buses(*nodes: int, names: Sequence[str] = (), **keys: Any) -> list[dict[str, Any]]:
    """Return buses with these numbers of nodes, called bus0, bus1 and so on, or `names`; all have the other `keys`."""
    called = names or [f"bus{place}" for place in range(len(nodes))]
    return [{"name": name, "nodes": count, **keys} for name, count in zip(called, nodes, strict=True)]


def in_turns(layout: Layout, turns: int = 2) -> Layout:
    """Return the layout with half of the frames of a node in odd and half in even cycles, or with other `turns`."""
    return changed(layout, sync={"turns": turns})


def in_one_instant(rate_hz: float = 100.0) -> Layout:
    """Return the default skin with all sums of a SYNC: what a file gets that says nothing."""
    return changed(load_layout(), sync={"rate_hz": rate_hz, "turns": 1}, device={"jitter_s": 1e-3})


def slow_layout(folder: Path, rate_hz: float, turns: int = 1) -> Path:
    """Write the default skin's layout, in one instant if not in `turns`, at a rate that every machine keeps.

    Nodes take one sample a SYNC, so that sums are those of the sensor's counts, rounded once.
    """
    slow = changed(load_layout(), sync={"rate_hz": rate_hz, "turns": turns}, sampling={"rate_hz": rate_hz})
    path = folder / f"slow-{turns}.toml"
    path.write_text(layout_text(slow))
    return path
