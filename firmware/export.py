"""The files of ``skin export firmware``: C sources that every board shares, and the constants of each board."""

from collections.abc import Sequence

from dbc.contract import Contract, NodeContract
from firmware.library import sources
from firmware.object_dictionary import od_header, od_source
from firmware.readme import folder_of, readme
from firmware.tables import board_header, board_source, builds

#: Folder of the package's sources, by folder of the export.
SHARED = ("", "slave", "canopennode")


def export_files(contract: Contract, nodes: Sequence[NodeContract]) -> dict[str, str]:
    """Return the text of every file by its path.

    Raises
    ------
    InputError
        If the nodes send adaptively, which this firmware does not do.
    """
    found = {f"src/{path}": text for path, text in sources(*SHARED).items()}
    boards = builds(contract, nodes)
    for build in boards:
        folder = f"boards/{folder_of(build)}"
        found |= {
            f"{folder}/board.h": board_header(contract, [build]),
            f"{folder}/board.c": board_source([build]),
            f"{folder}/OD.h": od_header(contract, build),
            f"{folder}/OD.c": od_source(contract, build),
        }
    return found | {"README.md": readme(contract, boards)}
