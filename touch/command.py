"""The verb ``skin objects``."""

import sys
from typing import Any


def objects(*, json: bool = False) -> None:
    """List the objects that can touch the simulated skin, with the taxels each presses and its peak force.

    The contact is that of the object in the middle of a skin of 64 x 64 taxels at 4 mm, pressed in by
    9.99 mm, the depth of the paper's data.

    Parameters
    ----------
    json : bool
        Print one JSON array instead of a table.

    Examples
    --------
    skin objects
    skin objects --json | jq 'max_by(.contact_taxels).name'
    """
    rows = _describe()
    if json:
        import msgspec

        sys.stdout.write(msgspec.json.encode(rows).decode() + "\n")
        return
    from rich.console import Console
    from rich.table import Table

    table = Table("object", "shape", "length mm", "width mm", "spheres", "taxels", "peak mN")
    for row in rows:
        table.add_row(
            row["name"],
            row["shape"],
            f"{row['length_m'] * 1e3:.1f}",
            f"{row['width_m'] * 1e3:.1f}",
            str(row["spheres"]),
            str(row["contact_taxels"]),
            f"{row['peak_force_n'] * 1e3:.2f}",
        )
    Console(file=sys.stdout).print(table)


def _describe() -> list[dict[str, Any]]:
    from touch.contact import Grid, Pose, press
    from touch.objects import CATALOGUE, spheres_of
    from touch.trajectory import PAPER_DEPTH_M

    rows = []
    for name, item in CATALOGUE.items():
        spheres = spheres_of(name)
        force_n = press(Grid(), [(spheres, Pose(0.0, 0.0, 0.0, PAPER_DEPTH_M))])
        rows.append(
            {
                "name": name,
                "shape": item.shape,
                "length_m": item.size_m[0],
                "width_m": item.size_m[1],
                "spheres": len(spheres),
                "contact_taxels": int((force_n > 0).sum()),
                "peak_force_n": round(float(force_n.max()), 6),
            }
        )
    return rows
