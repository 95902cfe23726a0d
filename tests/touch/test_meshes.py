"""Objects from meshes, on small ones made here."""

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh

from canskin.errors import InputError
from skin.sources import known_objects, object_label
from touch.meshes import LONGEST_EDGE_M, MeshPose, find_mesh, load_mesh
from touch.objects import checked_names, made_of, size_m, spheres_of

AS_IT_IS = MeshPose(("thing",), ())


def saved(path: Path, mesh: trimesh.Trimesh) -> Path:
    mesh.export(path)
    return path


def ball_mesh(radius: float = 0.03) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=radius)


def open_mesh() -> trimesh.Trimesh:
    mesh = ball_mesh()
    return trimesh.Trimesh(mesh.vertices, mesh.faces[1:])


@pytest.mark.heavy
@pytest.mark.parametrize("ending", ["ply", "stl", "obj", "off", "glb"])
def test_any_format_gives_the_same_spheres(tmp_path: Path, ending: str) -> None:
    mesh = ball_mesh()
    spheres = load_mesh(saved(tmp_path / f"thing.{ending}", mesh), AS_IT_IS)
    corners = mesh.vertices
    apart = np.linalg.norm(corners[:, None] - corners, axis=2) + 9 * np.eye(len(corners))
    np.testing.assert_allclose(spheres.radii_m, 2 * apart.min(axis=1).mean(), rtol=1e-5)
    assert len(spheres) == (corners[:, 2] > 0.03 - 0.02).sum()
    assert spheres.footprint_m(0.02)[0] == pytest.approx(0.06, abs=0.006)


def test_turns_are_made_one_after_the_other_and_y_runs_down(tmp_path: Path) -> None:
    mesh = trimesh.creation.box((0.1, 0.02, 0.02))
    for _ in range(5):
        mesh = mesh.subdivide()
    path = saved(tmp_path / "thing.ply", mesh)
    assert load_mesh(path, AS_IT_IS).footprint_m(0.005)[0] > 0.1
    turned = load_mesh(path, MeshPose(("thing",), (("z", math.pi / 2),)))
    assert turned.footprint_m(0.005)[1] > 0.1
    upright = load_mesh(path, MeshPose(("thing",), (("z", math.pi / 2), ("x", math.pi / 2))))
    assert max(upright.footprint_m(0.005)) < 0.04
    mesh.apply_translation((0.0, 0.0, 0.3))
    cone = trimesh.util.concatenate([mesh, ball_mesh(0.02).apply_translation((0.0, 0.04, 0.32))])
    leaning = load_mesh(saved(tmp_path / "leaning.ply", cone), AS_IT_IS)
    assert leaning.centres_m[leaning.centres_m[:, 2].argmax(), 1] < 0


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (ball_mesh(30.0), "60 m long.*scale it to metres"),
        (ball_mesh(1e-4), "long.*scale it to metres"),
        (trimesh.creation.box((0.1, 0.1, 0.1)), "too coarse.*100.0 mm apart.*subdivide"),
        (open_mesh(), "open.*closed surface"),
    ],
)
def test_meshes_that_cannot_be_used(tmp_path: Path, mesh: trimesh.Trimesh, message: str) -> None:
    with pytest.raises(InputError, match=message):
        load_mesh(saved(tmp_path / "thing.ply", mesh), AS_IT_IS)


def test_files_that_are_no_meshes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "thing.ply"
    path.write_bytes(b"")
    with pytest.raises(InputError, match=r"thing\.ply' cannot be read as a mesh"):
        load_mesh(path, AS_IT_IS)
    cloud = trimesh.PointCloud(np.eye(3))
    cloud.export(path)
    with pytest.raises(InputError, match="is empty"):
        load_mesh(path, AS_IT_IS)
    saved(path, ball_mesh())
    monkeypatch.setattr("touch.meshes.MOST_VERTICES", 100)
    with pytest.raises(InputError, match="2562 vertices, expected at most 100: decimate"):
        load_mesh(path, AS_IT_IS)
    monkeypatch.setattr("touch.meshes.MOST_BYTES", 1000)
    with pytest.raises(InputError, match="too large"):
        load_mesh(path, AS_IT_IS)


def test_the_folder_is_named_when_a_mesh_is_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a folder of meshes"):
        spheres_of("cup", tmp_path / "nowhere")
    (tmp_path / "clamp.txt").write_text("no mesh")
    with pytest.raises(InputError, match=r"no mesh clamp\.ply or largeclamp\.ply"):
        spheres_of("clamp", tmp_path)
    path = saved(tmp_path / "largeclamp.ply", ball_mesh())
    assert find_mesh(tmp_path, MeshPose(("clamp", "largeclamp"), ())) == path
    assert len(spheres_of("clamp", tmp_path)) > 100
    assert spheres_of("tuna-can", tmp_path) is not None


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("inch", 0.0254)])
def test_an_own_object_has_the_unit_that_the_user_names(tmp_path: Path, unit: str, metres: float) -> None:
    path = saved(tmp_path / "block.stl", trimesh.creation.box(np.array((0.06, 0.04, 0.03)) / metres))
    name = f"{path}@{unit}"
    assert object_label(name) == "block"
    assert made_of(name) == "block.stl"
    spheres = spheres_of(name)
    assert size_m(name) == pytest.approx((0.06, 0.04), abs=2 * spheres.radii_m[0] + 1e-6)
    places = spheres.centres_m[:, :2]
    assert spheres.radii_m[0] <= 2 * LONGEST_EDGE_M
    assert len(places) > 60 * 40 / 4
    turned = spheres_of(f"{name}:z90:y90")
    assert turned.footprint_m(0.01) == pytest.approx((0.03, 0.06), abs=2 * spheres.radii_m[0] + 1e-6)


def test_own_objects_that_cannot_be_used(tmp_path: Path) -> None:
    path, archive = saved(tmp_path / "ring.stl", ball_mesh(30.0)), tmp_path / "packed.zip"
    archive.write_bytes(b"")
    for name, message in (
        (f"{path}", r"in which unit is '.*ring\.stl'\? expected .*ring\.stl@mm or"),
        (f"{path}@feet", "expected FILE@UNIT with a unit of mm, cm, m, inch"),
        (f"{path}@mm:w5", "turns about an axis in degrees"),
        ("nowhere.stl@mm", r"no mesh at 'nowhere\.stl'"),
        (f"{archive}@mm", r"no mesh at '.*packed\.zip': expected a file that ends in \.ply"),
        (f"{path}@m", r"60 m long.*is its unit m\?"),
    ):
        with pytest.raises(InputError, match=message):
            spheres_of(name)
    with pytest.raises(InputError, match=r"'ring' and '.*' have the same name"):
        checked_names(f"ring,{path}@mm")
    assert "ring" not in known_objects([f"{path}@mm"])
