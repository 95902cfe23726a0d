"""What the paper prints, held against itself."""

from evaluation.paper.printed import SENSOR, TABLE_ONE, TABLE_THREE, TABLE_TWO
from touch.trajectory import ACQUISITION_OBJECTS


def test_every_cell_is_there_and_every_range_holds_its_mean() -> None:
    assert (len(TABLE_TWO), len(TABLE_THREE)) == (30, 30)
    assert all(set(row) == set(ACQUISITION_OBJECTS) for row in (*TABLE_ONE.values(), SENSOR))
    levels = [*SENSOR.values(), *(cell.psnr for cell in TABLE_THREE.values())]
    levels += [each for pair in TABLE_TWO.values() for each in pair.values()]
    assert all(each.least < each.mean < each.most for each in levels)
    assert all(mean < most for row in TABLE_ONE.values() for mean, most in row.values())


def test_twenty_iterations_of_table_three_are_the_noiselet_of_table_two() -> None:
    for (name, basis, iterations), cell in TABLE_THREE.items():
        if iterations == 20:
            assert cell.psnr == TABLE_TWO[name, "noiselet", 1024][basis]
            assert cell.psnr != TABLE_TWO[name, "sbhe", 1024][basis]
