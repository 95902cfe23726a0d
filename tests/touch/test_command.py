from pathlib import Path

import msgspec
import pytest
import trimesh

from canskin.errors import InputError
from touch.command import objects
from touch.objects import CATALOGUE


def test_json_lists_the_catalogue(capsys: pytest.CaptureFixture[str]) -> None:
    objects(json=True)
    rows = msgspec.json.decode(capsys.readouterr().out)
    assert [row["name"] for row in rows] == list(CATALOGUE)
    golf = rows[0]
    assert (golf["length_m"], golf["spheres"], golf["contact_taxels"]) == (0.04267, 1, 76)
    assert all(0.0095 < row["peak_force_n"] <= 0.00999 for row in rows)


def test_the_table_names_every_object_on_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    objects()
    out = capsys.readouterr().out
    assert all(name in out for name in CATALOGUE)
    assert max(map(len, out.splitlines())) <= 80


def test_named_objects_are_drawn(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    objects("cup,jello-box", figure=tmp_path / "two.png")
    table, *drawings = capsys.readouterr().out.split("\n\n")
    assert "golf-ball" not in table
    assert [drawing.splitlines()[0] for drawing in drawings] == ["cup", "jello-box"]
    box = drawings[1].splitlines()[1:]
    assert all(len(line) == 22 and set(line) <= {"%", "@"} for line in box)
    assert len(box) == 8
    assert (tmp_path / "two.png").exists()


def test_meshes_take_the_place_of_own_shapes(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    trimesh.creation.icosphere(subdivisions=4, radius=0.03).export(tmp_path / "drill.stl")
    objects("drill,golf-ball", meshes=tmp_path, json=True)
    drill, golf = msgspec.json.decode(capsys.readouterr().out)
    assert drill["made_of"] == "drill.stl"
    assert drill["length_m"] == pytest.approx(0.047, abs=0.003)
    assert golf["made_of"] == "ball"
    with pytest.raises(InputError, match=r"no mesh banana\.ply"):
        objects(meshes=tmp_path)
