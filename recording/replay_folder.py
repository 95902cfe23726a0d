"""The recordings of a folder as arrays of images: one task each, on the cores of this machine or of many."""

import hashlib
import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import msgspec

from calibration.calibrator import Tare
from calibration.offline import make_calibrator
from canskin.errors import InputError, RunError, SkinError, reasoned
from dbc.contract import Contract
from reconstructor.imaging import Imager, make_imager
from reconstructor.options import SolverOptions
from reconstructor.service import warm_up
from recording import RECORDING_SUFFIX, file_of, is_recording
from recording.image_arrays import ImageArrays
from recording.mcap_file import part_of, recording_id, wall_offset_ns
from recording.replaying import Replay
from recording.run_steps import steps_of
from recording.step_kinds import Step
from shell.output import alone, write_file
from shell.parallel import in_parallel
from shell.service import StopSignal, say
from shell.terminal import progress
from skin.layout import Layout, layout_text, load_layout

MANIFEST: Final = "manifest.json"
#: Ends the name of a file of images alone.
ARRAYS: Final = ".npz"


@dataclass(frozen=True)
class Settings:
    """How a recording becomes images: options of ``skin replay``."""

    layout: Path | None = None
    skin: str | None = None
    solver: SolverOptions | None = None
    calibration: Path | None = None
    tare: Tare = "never"
    gains: Path | None = None

    def digest(self) -> str:
        """Return a digest of the settings, of the layout and the files that they name, and of the version of canskin.

        Raises
        ------
        SkinError
            If one of these cannot be read.
        """
        layout = None if self.layout is None else layout_text(load_layout(self.layout))
        files = [each if each is None else _digest(each) for each in (self.calibration, self.gains)]
        told = repr((version("canskin"), self.skin, self.solver, self.tare, layout, files))
        return hashlib.sha256(told.encode()).hexdigest()[:16]

    def about(self, source: Path, skin: Layout) -> dict[str, Any]:
        """Return what made the images of a file."""
        solver = self.solver or SolverOptions()
        is_solved = self.solver is not None or skin.sends.in_cycles
        return {
            "format": "canskin images 1",
            "version": version("canskin"),
            "source": source.name,
            "solver": solver.solver if is_solved else "steps",
            "settings": asdict(solver.settings()) if is_solved else {},
            "noise_n": solver.noise_n,
        }


class Run:
    """A recorded run that can be played: its skin, what makes its images, and its steps.

    Parameters
    ----------
    source : Path
        A recording, or a log.
    channel : list of str, optional
        Of a log.

    Raises
    ------
    SkinError
        If a file cannot be used.
    """

    def __init__(self, source: Path, settings: Settings, channel: list[str] | None = None) -> None:
        self.source = source = part_of(source, settings.skin)
        is_kept = is_recording(source)
        self.skin = load_layout(source if is_kept and settings.layout is None else settings.layout)
        if channel and is_kept:
            raise InputError("--channel is for logs: a recording names its buses; leave it out")
        self.contract = Contract.from_layout(self.skin)
        self.offset_ns = wall_offset_ns(source) if is_kept else 0
        calibrator = make_calibrator(self.skin, settings.calibration, settings.tare, "replay")
        self.imager: Imager = make_imager(self.skin, settings.solver, settings.gains)
        warm_up(self.skin, self.imager)
        every = settings.solver is not None
        self.steps: Iterator[Step] = steps_of(source, self.contract, channel, every=every, calibrator=calibrator)


class Made(msgspec.Struct, kw_only=True):
    """What came of a recording.

    Attributes
    ----------
    sha256 : str
        Of the recording.
    settings : str
        See `Settings.digest`.
    images_sha256 : str
        Of the file of images.
    images : int
        Number of images.
    error : str
        Why there are none; empty if there are some.
    seconds : float
    """

    sha256: str
    settings: str
    images_sha256: str = ""
    images: int = 0
    error: str = ""
    seconds: float = 0.0


def replay_folder(folder: Path, out: Path, settings: Settings, jobs: int | str) -> None:
    """Make a file of images of each recording of a folder, and a manifest; see ``skin replay``.

    Parameters
    ----------
    jobs : int or str
        See `shell.parallel.in_parallel`. Workers of a cluster see both folders under the same names.

    Raises
    ------
    InputError
        If the folder has no recordings, or `out` cannot be used.
    RunError
        If a recording gave an error; the others are made all the same.
    """
    sources = {path.name: path.absolute() for path in sorted(folder.glob(f"*{RECORDING_SUFFIX}"))}
    if not sources:
        raise InputError(f"{folder}: expected recordings of 'skin record' (*{RECORDING_SUFFIX}), found none")
    # Workers have folders of their own in which they started.
    layout, calibration, gains = (
        path if path is None or not file_of(path).is_file() else path.absolute()
        for path in (settings.layout, settings.calibration, settings.gains)
    )
    settings = replace(settings, layout=layout, calibration=calibration, gains=gains)
    with alone(out):
        manifest, digest = _manifest(out / MANIFEST), settings.digest()
        made = {name: each for name, each in manifest.items() if name in sources}
        left = [
            name for name, path in sources.items() if not _is_made(made.get(name), path, _target(out, name), digest)
        ]
        say("replay", f"{folder}: {len(sources)} recordings, {len(sources) - len(left)} of them are made")
        calls = [partial(_make, sources[name], _target(out, name).absolute(), settings, digest) for name in left]
        bar_of_all = progress("images", len(sources), done=len(sources) - len(left))
        with bar_of_all as bar, closing(in_parallel(calls, jobs)) as work:
            for place, each in work:
                made[left[place]] = each
                write_file(out / MANIFEST, msgspec.json.format(msgspec.json.encode(dict(sorted(made.items())))))
                bar.advance()
    errors = {name: each.error for name, each in sorted(made.items()) if each.error}
    for name, error in errors.items():
        say("replay", f"{name}: {error}")
    say("replay", f"{sum(each.images for each in made.values())} images in {out}, made anew of {len(left)} recordings")
    if errors:
        raise RunError(f"{folder}: {len(errors)} of {len(sources)} recordings gave no images; a second run tries again")


def _target(out: Path, name: str) -> Path:
    return out / Path(name).with_suffix(ARRAYS)


def _manifest(path: Path) -> dict[str, Made]:
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Made])
    except FileNotFoundError:
        return {}
    except (OSError, msgspec.DecodeError) as error:
        raise InputError(f"{path}: expected the manifest of 'skin replay', got {error}: give another --out") from error


def _digest(path: Path) -> str:
    with reasoned(InputError, f"{path}: cannot be read"), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _is_made(made: Made | None, source: Path, target: Path, settings: str) -> bool:
    return (
        made is not None
        and not made.error
        and made.settings == settings
        and made.sha256 == _digest(source)
        and target.is_file()
        and made.images_sha256 == _digest(target)
    )


def _make(source: Path, target: Path, settings: Settings, digest: str) -> Made:
    """Make the images of a recording; an error is a result."""
    began_s = time.perf_counter()
    made = Made(sha256="", settings=digest)
    try:
        made.sha256 = _digest(source)
        run = Run(source, settings)
        images = ImageArrays(run.offset_ns)
        played = Replay(run.skin, run.imager, receivers=[images.publish], offset_ns=run.offset_ns)
        played.run(run.steps, StopSignal(), float("inf"))
        if not played.report.measured:
            raise RunError("no measurement with a valid block: is this the skin's layout?")
        images.save(target, run.skin, recording_id(run.source), settings.about(source, run.skin))
        made.images, made.images_sha256 = played.report.images.made, _digest(target)
    except (SkinError, OSError) as error:
        made.error = str(error)
    made.seconds = round(time.perf_counter() - began_s, 3)
    return made
