"""Content of a data set: settings, and its chunks."""

import zlib
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np

from canskin.errors import InputError
from skin.defects import KINDS, Stage, option_name
from skin.ranges import require_number
from skin.sources import object_label
from skin.taxel import TaxelModel
from touch.classification_poses import CLASSIFICATION_OBJECTS, PERTURBATIONS, observe, poses
from touch.coarse_arrays import ARRAYS, FINE_SIDE, Kind, averaged, grid_of
from touch.contact import Force, Grid, Pose, Spheres, press_along
from touch.datasets.options import DEFECTS
from touch.objects import checked_names, made_of, spheres_of
from touch.trajectory import ACQUISITION_OBJECTS, PAPER_STEP_S, paper_pose, start_of, trajectory_range

#: Steps of a trajectory in one chunk: 11 MB per signal.
CHUNK_STEPS: Final = 700
SIGNALS: Final = ("true", "sensor")
#: Stages of defects that a single moment does not show.
_IN_TIME: Final = (Stage.SPEED, Stage.DRIFT)


@dataclass(frozen=True)
class Task:
    """Files of one chunk.

    Attributes
    ----------
    files : dict
        Description of each file in the manifest, by path in the folder.
    make : callable
        Returns the arrays of the files in this order; picklable.
    """

    files: dict[str, dict[str, Any]]
    make: Callable[[], list[Force]]


@dataclass(frozen=True)
class DatasetPlan:
    """A data set: ``about`` goes into its manifest, ``tasks`` make its chunks."""

    about: dict[str, Any]
    tasks: tuple[Task, ...]

    @property
    def objects(self) -> dict[str, dict[str, Any]]:
        """Source of each object's spheres, by name."""
        found: dict[str, dict[str, Any]] = self.about["settings"]["objects"]
        return found


def plan_acquisition(
    names: Sequence[str] | None = None,
    *,
    meshes: Path | None = None,
    speed: int = 1,
    steps: int | None = None,
    model: TaxelModel,
    seed: int = 0,
) -> DatasetPlan:
    """Return the data set of the paper's trajectories (section V-A).

    Parameters
    ----------
    names : sequence of str, optional
        Some of the paper's five objects; default: all.
    meshes, speed, steps
        As for `touch.trajectory.trajectory`.
    model : TaxelModel
        Model of the sensor.
    seed : int
        Seed of the noise.
    """
    require_number("seed", seed)
    listed = tuple(ACQUISITION_OBJECTS) if names is None else checked_names(names)
    taken = range(*trajectory_range(speed, steps))
    tasks = []
    for name in listed:
        start, spheres = start_of(name), spheres_of(name, meshes)
        way = [paper_pose(step, start.start_m, start.rotation_rad) for step in taken]
        for first in range(0, len(way), CHUNK_STEPS):
            about = {"object": object_label(name), "first_step": first}
            files = _pair(f"{object_label(name)}/{{}}-{first // CHUNK_STEPS:02d}.npy", about)
            # With the step before, which a damper needs.
            stretch = way[max(first - 1, 0) : first + CHUNK_STEPS]
            tasks.append(Task(files, partial(_steps, spheres, stretch, first, _Sensor(model, seed, tuple(files)))))
    settings = {"speed": speed, "steps": len(taken), **_settings(seed, model)}
    about = _about("acquisition", "step, row, column", settings, listed, meshes)
    about["period_s"] = PAPER_STEP_S
    about["starts"] = {object_label(name): asdict(start_of(name)) for name in listed}
    return DatasetPlan(about, tuple(tasks))


def plan_classification(
    names: Sequence[str] | None = None,
    *,
    meshes: Path | None = None,
    sides: Sequence[int] = ARRAYS,
    kind: Kind = "averaged",
    perturbations: int = PERTURBATIONS,
    model: TaxelModel,
    seed: int = 0,
) -> DatasetPlan:
    """Return the data set of the paper's observations, for each array and object (section V-B).

    Parameters
    ----------
    names : sequence of str, optional
        Objects of the catalogue; default: the paper's 16.
    meshes, kind, perturbations
        As for `touch.classification_poses.observations`.
    sides : sequence of int
        Some of `touch.coarse_arrays.ARRAYS`.
    model : TaxelModel
        Model of the sensor, without damper and drift, because an observation is a single moment.
    seed : int
        Seed of the noise, and of the draw of fewer than 360 perturbations.
    """
    require_number("seed", seed)
    if not model.defects.stages.keys().isdisjoint(_IN_TIME):
        unseen = " and ".join(option_name(name) for name, kind in DEFECTS.items() if kind.stage in _IN_TIME)
        raise InputError(f"observations are single moments: {unseen} need a trajectory, leave them out")
    listed = CLASSIFICATION_OBJECTS if names is None else checked_names(names)
    drawn = poses(perturbations, seed)
    if not sides:
        raise InputError(f"no array named: expected one or more of {', '.join(map(str, ARRAYS))}")
    for side in sides:
        grid_of(side, kind)
    once = tuple(dict.fromkeys(sides))
    tasks = []
    for name in listed:
        files: dict[str, dict[str, Any]] = {}
        for side in once:
            about = {"object": object_label(name), "side": side, "kind": kind}
            files |= _pair(f"{kind}-{side:02d}x{side:02d}/{object_label(name)}-{{}}.npy", about)
        sensor = _Sensor(model, seed, tuple(files))
        tasks.append(Task(files, partial(_moments, spheres_of(name, meshes), drawn, once, kind, sensor)))
    settings = {
        "sides": list(once),
        "kind": kind,
        "perturbations": perturbations,
        **_settings(seed, model),
    }
    about = _about("classification", "perturbation, row, column", settings, listed, meshes)
    about["poses"] = [
        {name: round(value, 9) for name, value in zip(Pose._fields[:4], pose[:4], strict=True)} for pose in drawn
    ]
    return DatasetPlan(about, tuple(tasks))


@dataclass(frozen=True)
class _Sensor:
    """Computes sensor signals; each file has its own seed, independent of the other files."""

    model: TaxelModel
    seed: int
    files: tuple[str, ...]

    def signal(self, index: int, force_n: Force, start_s: float = 0.0) -> Force:
        key = zlib.crc32(self.files[index].encode())
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(key,)))
        return self.model.signal(force_n, rng, period_s=PAPER_STEP_S, start_s=start_s)


def _steps(spheres: Spheres, stretch: Sequence[Pose], first: int, sensor: _Sensor) -> list[Force]:
    """Return a part of a trajectory; every part except the first begins one step early."""
    early = 1 if first else 0
    force_n = press_along(Grid(), spheres, stretch)
    signal = sensor.signal(1, force_n, (first - early) * PAPER_STEP_S)
    return [force_n[early:], signal[early:]]


def _moments(spheres: Spheres, at: Sequence[Pose], sides: Sequence[int], kind: Kind, sensor: _Sensor) -> list[Force]:
    """Return the observations of one object with all arrays."""
    fine = observe(spheres, at, FINE_SIDE, kind) if kind == "averaged" else None
    made: list[Force] = []
    for side in sides:
        force_n = observe(spheres, at, side, kind) if fine is None else averaged(fine, side)
        made += [force_n, sensor.signal(len(made) + 1, force_n)]
    return made


def _pair(path: str, about: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Return the descriptions of the files of both signals."""
    return {path.format(signal): {**about, "signal": signal} for signal in SIGNALS}


def _about(
    name: str, axes: str, settings: dict[str, Any], listed: Sequence[str], meshes: Path | None
) -> dict[str, Any]:
    objects = {}
    for each in listed:
        spheres = spheres_of(each, meshes)
        digest = sha256(spheres.centres_m.tobytes() + spheres.radii_m.tobytes()).hexdigest()
        objects[object_label(each)] = {"made_of": made_of(each, meshes), "spheres": len(spheres), "sha256": digest}
    return {
        "data_set": name,
        "made_by": f"canskin {version('canskin')}",
        "axes": axes,
        "units": {"true": "N", "sensor": "N"},
        "dtype": "float32",
        "settings": {**settings, "objects": objects},
    }


def _settings(seed: int, model: TaxelModel) -> dict[str, Any]:
    given = {each.kind: each for each in model.defects.of_kinds}
    defects: dict[str, dict[str, float] | None] = dict.fromkeys(DEFECTS)
    for name, defect in given.items():
        is_drawn = KINDS[name].stream is not None
        defects[name] = {KINDS[name].amount: defect.amount} | ({"seed": defect.seed} if is_drawn else {})
    return {"seed": seed, "noise_n": model.noise_n, "force_max_n": model.force_max_n, **defects}
