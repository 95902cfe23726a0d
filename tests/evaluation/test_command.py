"""The user's own objects in ``skin evaluate``."""

import pytest
import trimesh

from canskin.errors import InputError
from evaluation.command import evaluate
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


def test_what_takes_no_objects_says_so_and_unknown_objects_are_refused(puck: str) -> None:
    for subject, options in (("calibration", {}), ("rivals", {"scene_seed": 3})):
        with pytest.raises(InputError, match="only the slides of 'rivals' have objects to choose"):
            evaluate(subject, objects=puck, **options)  # type: ignore[arg-type]  # of a loop
    with pytest.raises(InputError, match=r"no mesh at 'none\.stl'"):
        evaluate("rivals", objects="none.stl@mm")
    with pytest.raises(InputError, match="no trajectory of 'ring'"):
        evaluate("rivals", objects="ring")
