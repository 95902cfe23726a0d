"""``README.md`` of an export, for the engineer who builds the firmware."""

from collections.abc import Sequence
from string import Template

from dbc.contract import Contract
from firmware.library import SOURCES
from firmware.tables import Build


def readme(contract: Contract, boards: Sequence[Build]) -> str:
    """Return the text, with the figures of the first of `boards`."""
    node, board = boards[0].node, boards[0].board
    folder = SOURCES.joinpath("adaptive") if board.sending == "adaptive" else SOURCES
    template = Template(folder.joinpath("README.md").read_text(encoding="utf-8"))
    return template.substitute(
        skin=board.skin,
        blocks=node.blocks,
        block_size=contract.phi.block_size,
        sums=node.sums,
        board=folder_of(boards[0]),
        period_us=board.sync_period_us,
        window_us=board.sync_window_us,
        samples=board.samples_per_sync,
    )


def folder_of(build: Build) -> str:
    """Return the name of a board's folder."""
    return f"{build.board.bus}-{build.board.node_id:03}"
