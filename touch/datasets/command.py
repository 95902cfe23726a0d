"""``skin touch dataset``."""

import contextlib
import os
import time
from pathlib import Path
from typing import Any, Final, Literal

from canskin.errors import InputError
from shell.output import alone
from shell.parallel import Cluster, in_parallel
from shell.terminal import Json, print_json, print_table, progress
from touch.coarse_arrays import ARRAYS
from touch.datasets.folder import DatasetFolder
from touch.datasets.options import AcquisitionOptions, ClassificationOptions, TaxelOptions
from touch.datasets.plan import DatasetPlan, plan_acquisition, plan_classification
from touch.objects import checked_names

#: Chunks per process between two writes: finished chunks must not fill the memory.
_AHEAD: Final = 4

Subject = Literal["acquisition", "classification"]
_SLIDES: Final = AcquisitionOptions()
_TOUCHES: Final = ClassificationOptions()
_TAXELS: Final = TaxelOptions()


def dataset(
    subject: Subject,
    *,
    out: Path,
    objects: str | None = None,
    meshes: Path | None = None,
    seed: int = 0,
    jobs: int | None = None,
    cluster: Cluster = None,
    slides: AcquisitionOptions = _SLIDES,
    touches: ClassificationOptions = _TOUCHES,
    taxels: TaxelOptions = _TAXELS,
    json: Json = False,
) -> None:
    """Make one of the paper's two data sets in a folder.

    ``acquisition`` presses and slides five objects over 64 x 64 taxels: 4200 steps of 1 ms each, 690 MB.
    ``classification`` touches 16 objects from 360 offsets with seven arrays: 40320 observations, 250 MB. Each chunk is
    two .npy files of float32 newtons, the true force and the sensor signal. manifest.json holds the settings, the units
    and the SHA-256 of every file. A second run completes an interrupted one and makes damaged files again. A folder
    with other settings is refused.

    Parameters
    ----------
    subject
        The data set.
    out
        Folder of the data set.
    objects
        Comma-separated names; default: all objects of the paper.
    meshes
        Folder of meshes (banana, cup, drill, largeclamp, mustard) to use in place of our own shapes.
    seed
        Seed of all random numbers.
    jobs
        Number of processes; default: one per core.
    json
        Print JSON instead of a table.

    Examples
    --------
    skin touch dataset classification --out touches
    skin touch dataset acquisition --out slides --objects drill,cup --meshes ycb-meshes
    skin touch dataset acquisition --out worn --defect gain-spread=0.05 dead=0.01 --json
    """
    names = None if objects is None else checked_names(objects)
    model = taxels.model(seed)
    if subject == "acquisition":
        if touches != _TOUCHES:
            raise InputError("--arrays, --kind and --perturbations belong to 'classification': leave them out")
        speed, steps = slides.speed, slides.steps
        plan = plan_acquisition(names, meshes=meshes, speed=speed, steps=steps, model=model, seed=seed)
    else:
        if slides != _SLIDES:
            raise InputError("--speed and --steps belong to 'acquisition': leave them out")
        plan = plan_classification(
            names,
            meshes=meshes,
            sides=_sides(touches.arrays),
            kind=touches.kind,
            perturbations=touches.perturbations,
            model=model,
            seed=seed,
        )
    with alone(out):
        done = fill(plan, out, cluster or ((os.cpu_count() or 1) if jobs is None else jobs))
    _show(done, as_json=json)


def fill(plan: DatasetPlan, out: Path, jobs: int | str) -> dict[str, Any]:
    """Make the missing files of a data set, with a progress bar on a terminal's stderr.

    Returns
    -------
    dict
        ``folder``, ``data_set``, ``files``, ``files_made``, ``bytes``, ``seconds``, and the files and frames of each
        object.
    """
    began_s = time.monotonic()
    folder = DatasetFolder(out, plan.about)
    with progress("looking", len(plan.tasks)) as bar:
        missing = []
        for task in plan.tasks:
            if all(folder.holds(name) for name in task.files):
                bar.advance()
            else:
                missing.append(task)
        bar.update(len(plan.tasks) - len(missing), plan.about["data_set"])
        calls = [task.make for task in missing]
        with contextlib.closing(in_parallel(calls, jobs, ahead=_AHEAD)) as work:
            for place, arrays in work:
                folder.put(missing[place].files, arrays)
                bar.advance()
    return _summary(folder, plan, sum(len(task.files) for task in missing), time.monotonic() - began_s)


def _summary(folder: DatasetFolder, plan: DatasetPlan, files_made: int, seconds: float) -> dict[str, Any]:
    objects = {name: {"made_of": about["made_of"], "files": 0, "bytes": 0} for name, about in plan.objects.items()}
    for task in plan.tasks:
        for name, about in task.files.items():
            found = objects[about["object"]]
            found["files"] += 1
            found["bytes"] += (folder.path / name).stat().st_size
    return {
        "data_set": plan.about["data_set"],
        "folder": str(folder.path),
        "files": sum(about["files"] for about in objects.values()),
        "files_made": files_made,
        "bytes": sum(about["bytes"] for about in objects.values()),
        "seconds": round(seconds, 2),
        "objects": objects,
    }


def _show(done: dict[str, Any], *, as_json: bool) -> None:
    if as_json:
        print_json(done)
        return
    sizes = {name: (about["made_of"], about["files"], about["bytes"]) for name, about in done["objects"].items()}
    sizes["all"] = ("", done["files"], done["bytes"])
    rows = [(name, made_of, files, f"{size / 1e6:.1f}") for name, (made_of, files, size) in sizes.items()]
    print_table(("object", "made of", "files", "MB"), rows)
    kept = done["files"] - done["files_made"]
    before = f", {kept} were there" if kept else ""
    print(f"{done['folder']}: {done['files_made']} files made in {done['seconds']} s{before}")


def _sides(arrays: str) -> tuple[int, ...]:
    try:
        return tuple(int(side) for side in arrays.split(","))
    except ValueError:
        known = ",".join(map(str, ARRAYS))
        raise InputError(f"--arrays needs numbers with commas between, such as {known}: got '{arrays}'") from None
