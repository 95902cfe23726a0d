"""The user's own objects in ``skin evaluate``."""

import pytest
import trimesh

from canskin.errors import InputError
from evaluation.command import rivals
from evaluation.schemes.scenes import Touch


@pytest.fixture(scope="module")
def puck(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("meshes") / "puck.stl"
    trimesh.creation.cylinder(radius=15, height=10).export(path)
    return f"{path}@mm"


def test_an_own_mesh_slides_and_is_called_by_its_file(puck: str) -> None:
    touch = Touch(puck, ticks=200)
    assert touch.words == "puck"
    assert touch.load().true_n[-1].max() > 0


def test_drawn_scenes_take_no_objects_and_unknown_objects_are_refused(puck: str) -> None:
    with pytest.raises(InputError, match="drawn scenes have no objects to choose"):
        rivals(objects=puck, scene_seed=3)
    with pytest.raises(InputError, match=r"no mesh at 'none\.stl'"):
        rivals(objects="none.stl@mm")
    with pytest.raises(InputError, match="no trajectory of 'ring'"):
        rivals(objects="ring")
