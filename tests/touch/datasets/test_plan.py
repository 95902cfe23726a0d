from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError
from skin.defects import Defects
from skin.taxel import TaxelModel
from touch.classification_poses import observations
from touch.contact import Force
from touch.datasets.plan import DatasetPlan, plan_acquisition, plan_classification
from touch.trajectory import trajectory

PLAIN = TaxelModel()


def all_made(plan: DatasetPlan) -> dict[str, Force]:
    return {name: values for task in plan.tasks for name, values in zip(task.files, task.make(), strict=True)}


def test_all_of_the_papers_observations_are_planned() -> None:
    plan = plan_classification(model=PLAIN)
    files = [about for task in plan.tasks for about in task.files.values()]
    assert len(plan.objects) == 16
    assert len(plan.about["poses"]) == 360
    assert sum(about["signal"] == "sensor" for about in files) * 360 == 40320


def test_all_of_the_papers_steps_are_planned() -> None:
    plan = plan_acquisition(model=PLAIN)
    assert len(plan.tasks) == 5 * 6
    assert plan.about["settings"]["steps"] == 4200
    assert [name for name, start in plan.about["starts"].items() if start["exact"]] == ["golf-ball"]


@pytest.mark.heavy
def test_trajectories_are_true_force_and_seeded_noise() -> None:
    plan = plan_acquisition(["golf-ball", "clamp"], speed=5, model=PLAIN, seed=3)
    arrays = all_made(plan)
    for name in ("golf-ball", "clamp"):
        true = np.concatenate([arrays[f"{name}/true-{part:02d}.npy"] for part in (0, 1)])
        sensor = np.concatenate([arrays[f"{name}/sensor-{part:02d}.npy"] for part in (0, 1)])
        np.testing.assert_array_equal(true, trajectory(name, speed=5))
        assert sensor.dtype == true.dtype == np.float32
        inside = true > 0.005
        assert (sensor - true)[inside].std() == pytest.approx(1e-3, rel=0.02)
        assert 0 <= sensor.min() <= sensor.max() <= np.float32(0.02)
    alone = all_made(plan_acquisition(["clamp"], speed=5, model=PLAIN, seed=3))
    np.testing.assert_array_equal(alone["clamp/sensor-01.npy"], arrays["clamp/sensor-01.npy"])
    other = all_made(plan_acquisition(["clamp"], speed=5, model=PLAIN, seed=4))
    assert (other["clamp/sensor-01.npy"] != alone["clamp/sensor-01.npy"]).any()


@pytest.mark.heavy
def test_damper_and_drift_do_not_see_where_chunks_begin() -> None:
    worn = TaxelModel(noise_n=0.0, defects=Defects.of({"damper": 0.01, "drift": 1e-3}, 2))
    arrays = all_made(plan_acquisition(["golf-ball"], steps=1400, model=worn))
    sensor = np.concatenate([arrays["golf-ball/sensor-00.npy"], arrays["golf-ball/sensor-01.npy"]])
    whole = worn.signal(trajectory("golf-ball", steps=1400), np.random.default_rng(0), period_s=1e-3)
    np.testing.assert_allclose(sensor, whole, rtol=0, atol=2e-9)


def test_observations_of_every_array_are_of_the_same_touches() -> None:
    names = ("tuna-can", "banana")
    plan = plan_classification(names, sides=(64, 8, 8, 1), perturbations=4, model=PLAIN, seed=1)
    arrays = all_made(plan)
    assert len(arrays) == 2 * 2 * 3
    for side in (64, 8, 1):
        expected = observations(side, perturbations=4, seed=1, names=names)
        for name, true in zip(names, expected, strict=True):
            np.testing.assert_array_equal(arrays[f"averaged-{side:02d}x{side:02d}/{name}-true.npy"], true)
            assert arrays[f"averaged-{side:02d}x{side:02d}/{name}-sensor.npy"].shape == (4, side, side)
    large = all_made(plan_classification(names, sides=(4,), kind="large", perturbations=4, model=PLAIN, seed=1))
    np.testing.assert_array_equal(
        large["large-04x04/banana-true.npy"], observations(4, "large", perturbations=4, seed=1, names=names)[1]
    )


def test_wrong_wishes_are_refused(tmp_path: Path) -> None:
    refused = pytest.raises(InputError)
    with refused:
        plan_acquisition(["banana"], model=PLAIN)
    with refused:
        plan_acquisition([], model=PLAIN)
    with refused:
        plan_acquisition(seed=-1, model=PLAIN)
    with refused:
        plan_acquisition(speed=0, model=PLAIN)
    with refused:
        plan_acquisition(meshes=tmp_path, model=PLAIN)
    with refused:
        plan_classification(sides=(5,), model=PLAIN)
    with refused:
        plan_classification(sides=(), model=PLAIN)
    with refused:
        plan_classification(perturbations=0, model=PLAIN)
    with refused:
        plan_classification(seed=-1, model=PLAIN)
    with pytest.raises(InputError, match="damper and drift need a trajectory"):
        plan_classification(model=TaxelModel(defects=Defects.of({"drift": 0.1})))
