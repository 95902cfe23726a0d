"""Skins from the files of others, made here as their makers write them."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import LayoutError
from skin.importing import read_icub, read_urdf, tables_of
from skin.layout import parse_layout
from skin.regions import regions_of
from tests.descriptions import NO_TAXEL, URDF, icub


def test_triangles_of_an_icub_are_boards_of_ten(tmp_path: Path) -> None:
    found = read_icub(*icub(tmp_path, {0: "triangle_10pad", 2: "triangle_10pad"}))
    assert found.told == []
    assert found.boards is not None
    assert len(found.places) == 20
    assert [place for board, place in found.boards if board == 1] == [0, 1, 2, 3, 4, 5, 7, 8, 9, 11]
    assert found.places[10][0] == pytest.approx(0.0665)


def test_channels_without_a_position_of_their_own_are_told(tmp_path: Path) -> None:
    where_pad_3_is = "0.0000 0.0000 0.0000 0 0 1"
    files = icub(tmp_path, {0: "triangle_10pad", 1: "fingertip"}, {0: where_pad_3_is, 12: NO_TAXEL})
    found = read_icub(*files)
    assert len(found.places) == 9 + 11
    assert found.told == ["1 channels of arm.txt have the position of another, and are left out"]
    with (tmp_path / "arm.ini").open("a") as file:
        file.write("triangle_10pad 3 0 0 0 5 1\n")
    assert "module 3 of arm.ini has no positions, and is left out" in read_icub(*files).told


def test_normals_are_left_out_where_some_are_missing(tmp_path: Path) -> None:
    found = read_icub(*icub(tmp_path, {0: "triangle_10pad"}, {1: "0.0098 -0.0057 0 0 0 0"}))
    assert {len(place) for place in found.places} == {3}


@pytest.mark.parametrize(
    ("modules", "lines", "says"),
    [
        ({0: "quad16"}, {}, "arm.ini, line 4: expected one of triangle_10pad, .*, got quad16 0"),
        ({0: "triangle_10pad"}, {0: "1 2 three 0 0 1"}, "arm.txt, line 4: expected six numbers: .*three"),
        ({0: "triangle_10pad"}, {0: "1 2 3"}, "arm.txt, line 4: expected six numbers, got 3"),
        ({}, {}, "no channel of the modules in arm.ini has a position"),
    ],
)
def test_wrong_icub_files(tmp_path: Path, modules: dict[int, str], lines: dict[int, str], says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        read_icub(*icub(tmp_path, modules, lines))


def test_an_icub_file_without_its_ini_or_heading(tmp_path: Path) -> None:
    positions, _ = icub(tmp_path, {0: "triangle_10pad"})
    with pytest.raises(LayoutError, match=r"needs the \.ini of its part"):
        read_icub(positions, None)
    with pytest.raises(LayoutError, match=r"expected a line \[SENSORS\], found none"):
        read_icub(positions, positions)


def test_taxels_of_a_urdf_are_in_the_frame_of_its_root(tmp_path: Path) -> None:
    path = tmp_path / "hand.urdf"
    path.write_text(URDF.format(order="row-major"))
    places = np.array(read_urdf(path).places)
    assert places[:6, :3] == pytest.approx(
        np.array([(0.004 * row - 0.001, 0.005 * column, 0.11) for row in range(2) for column in range(3)])
    )
    assert places[6:, :3] == pytest.approx(np.array([(0.05, 0, 0.1), (0.05, 0, 0.098)]), abs=1e-6)
    assert places[6, 3:] == pytest.approx((1, 0, 0), abs=1e-4)
    path.write_text(URDF.format(order="column-major"))
    assert np.array(read_urdf(path).places)[1, :2] == pytest.approx((0.003, 0))


def test_sensors_of_a_urdf_are_regions_if_each_has_a_name(tmp_path: Path) -> None:
    path = tmp_path / "hand.urdf"
    for names, expected in ((("Left-Palm", "3"), {"left_palm": 6, "sensor_3": 2}), (("palm", "Palm"), {})):
        text = URDF.format(order="row-major")
        for old, new in zip(("palm", "tip"), names, strict=True):
            text = text.replace(f'<sensor name="{old}"', f'<sensor name="{new}"')
        path.write_text(text)
        tables, _ = tables_of(str(path))
        layout = parse_layout(
            msgspec.toml.encode({"name": "hand", "sending": "steps", "measurement": {"wiring": "board"}} | tables),
            "hand.toml",
        )
        regions = regions_of(layout)[1:] if "region" in tables else []
        assert {each.name: each.taxels.sum() for each in regions} == expected
        if regions:
            assert regions[0].taxels[:6].all()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("</robot>", "", "cannot read it as URDF"),
        ("<tactile", "<force", "cannot read it as URDF"),
        ('rows="2"', 'rows="two"', "not a description with tactile sensors.*two"),
        ('<parent link="tip"/>', "", "not a description with tactile sensors.*<sensor> without <parent>"),
        ('size="0.004 0.005"', 'size="0.004"', "expected 2 numbers"),
        ('<link name="tip"/>', "", "no link 'tip'"),
        ('<parent link="base"/><child link="palm"/>', '<parent link="tip"/><child link="palm"/>', "are a loop"),
        (
            '<parent link="base"/><child link="palm"/>',
            '<parent link="base"/><child link="tip"/>',
            "'tip' is the child of two",
        ),
        ('idx="1"', 'idx="0"', "sensor 'tip': expected each idx once, from 0 on, got 0"),
        ('idx="1"', 'idx="-1"', "sensor 'tip': expected each idx once, from 0 on, got -1"),
        ('idx="1" ', "", "<taxel> without 'idx'"),
        ('rows="2"', 'rows="-2"', "expected 1 row and column of an <array> or more"),
        ('rows="2"', 'rows="100000000000"', "expected at most 65536 taxels"),
        ('order="row-major"', 'order="snake"', "expected row-major or column-major .* got snake"),
        ('offset="0.001 0"/>', 'offset="0.001 0"/><taxel idx="0"/>', "'palm' has both <array> and <taxel>"),
    ],
)
def test_wrong_urdf_files(tmp_path: Path, old: str, new: str, says: str) -> None:
    path = tmp_path / "hand.urdf"
    text = URDF.format(order="row-major")
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(LayoutError, match=says):
        read_urdf(path)


def test_gaps_between_the_taxels_of_a_urdf_are_told(tmp_path: Path) -> None:
    path = tmp_path / "hand.urdf"
    path.write_text(URDF.format(order="row-major").replace('idx="1"', 'idx="5"'))
    found = read_urdf(path)
    assert len(found.places) == 8
    assert found.told == ["sensor 'tip' has 2 taxels of idx up to 5: gaps close up"]


def test_a_long_arm_has_its_taxels_at_its_end(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    joint = "<link name='{0}'/><joint><parent link='{0}'/><child link='{1}'/><origin xyz='0.001 0 0'/></joint>"
    joints = "".join(joint.format(each, each + 1) for each in range(3000))
    sensor = "<sensor><parent link='3000'/><tactile><taxel idx='0'/></tactile></sensor>"
    path.write_text(f"<robot>{joints}<link name='3000'/>{sensor}</robot>")
    assert read_urdf(path).places[0] == pytest.approx((3.0, 0, 0, 0, 0, 1))


def test_a_urdf_without_taxels(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text("<robot name='arm'><link name='base'/></robot>")
    with pytest.raises(LayoutError, match="expected a <sensor> with <tactile>, found none"):
        read_urdf(path)


def test_words_and_layouts_are_taxels_too() -> None:
    assert tables_of("24x32") == ({"taxels": {"rows": 24, "columns": 32}}, [])
    tables, _ = tables_of("hand")
    assert tables["taxels"]["rows"] == 16
    with pytest.raises(LayoutError, match="no such file, and no layout of canskin"):
        tables_of("24 by 32")
