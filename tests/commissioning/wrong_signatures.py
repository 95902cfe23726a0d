"""Boards whose signature of gains and offsets (2009h) is wrong."""

from dbc import indices as od
from dbc.configuration import calibration, configuration, signature, with_calibration
from tests.world import Skin


def computed_once(bench: Skin) -> None:
    """Have the first board compute 2009h once."""
    readers = bench.segments[0].boards.nodes[0].objects.readers
    kept = readers[od.CALIBRATION_SIGNATURE](0)
    readers[od.CALIBRATION_SIGNATURE] = lambda _: kept


def without_offsets(bench: Skin) -> None:
    """Have the first board leave offsets out of 2009h."""
    objects, of = bench.segments[0].boards.nodes[0].objects, (bench.contract, bench.contract.nodes[0])
    covered = [each for each in with_calibration(configuration(*of), calibration(*of)) if each.index != od.OFFSET]
    objects.readers[od.CALIBRATION_SIGNATURE] = lambda _: signature(
        (each.index, each.subindex, objects.local.get_data(each.index, each.subindex)) for each in covered
    )
