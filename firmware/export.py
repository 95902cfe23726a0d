"""The files of ``skin export firmware``: C sources that every board shares, and the constants of each board."""

from collections.abc import Sequence

from dbc.contract import Contract, NodeContract
from firmware.library import constants, shared_folders, sources
from firmware.object_dictionary import od_header, od_source
from firmware.readme import folder_of, readme
from firmware.tables import builds


def export_files(contract: Contract, nodes: Sequence[NodeContract]) -> dict[str, str]:
    """Return the text of every file by its path."""
    folders = *shared_folders(contract), "slave", "canopennode"
    found = {f"src/{path}": text for path, text in sources(*folders).items()}
    boards = builds(contract, nodes)
    for build in boards:
        folder = f"boards/{folder_of(build)}"
        found |= {f"{folder}/{name}": text for name, text in constants(contract, [build]).items()}
        found |= {
            f"{folder}/OD.h": od_header(contract, build),
            f"{folder}/OD.c": od_source(contract, build),
        }
    return found | {"README.md": readme(contract, boards)}
