"""The options that say what touches a skin and what its taxels make of the touch, shared by all verbs."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

from canskin.errors import InputError
from skin.defects import KINDS, Defects, option_name, parse_defects, parse_stops
from skin.layout import Layout
from skin.ranges import listed
from skin.sources import StrokeKind, TaxelSource, load_objects, load_source, object_names, step_rate_hz

ObjectNames = Annotated[
    list[str],
    Parameter(
        help="Names of the objects, see ``skin touch objects``, with spaces or commas between; ``paper`` for the"
        " paper's sixteen; FILE@UNIT for your own mesh, for example ``cup.stl@mm``; default: a series of five."
    ),
]
FullScale = Annotated[
    float | None,
    Parameter(
        help="Recorded value that becomes the skin's largest force; default: the largest value of the recording."
    ),
]
ArrayNames = Annotated[
    list[str] | None, Parameter(help="Name of an array in the .npz; two arrays are placed side by side.")
]
_KINDS: Final = " ".join(f"{option_name(name)} ({kind.default:g}): {kind.help}" for name, kind in KINDS.items())


@Parameter(name="*")
@dataclass(frozen=True)
class TouchOptions:
    """A simulated or recorded touch, and the errors of the taxels.

    Attributes
    ----------
    objects
        Objects that touch the skin.
    stroke
        ``slide``: objects press at any place and angle, and slide. ``press``: as in the paper's classification, within
        10 mm and 45 degrees of the middle, 9.99 mm deep, without a slide.
    input
        A recording to play in place of the simulator: .npz or .npy of shape (time, rows, columns), or .mcap.
    full_scale
        Recorded value that becomes the skin's largest force.
    array
        Arrays of the .npz.
    rate
        Frames per second of the recording; without this option each cycle plays the next frame (stepped layouts: each
        10 ms).
    defect
        Defects of the taxels and of sums that are made in hardware.
    drift
        Drifts of zero at a place, each PLACE:COURSE:AMOUNT_N[:START_S[:DURATION_S]]; START_S counts from the first
        SYNC. PLACE: whole, half (the left one), gradient (from 0 to the amount across the columns), patchSIDE or
        patchSIDE@ROW,COLUMN (a square of taxels), boardBLOCK (the taxels of a block), converterBLOCK. COURSE: step,
        ramp (60 s), exponential (time constant 60 s), daily (a sine, 24 h).
    frozen
        Boards whose converters stop while their frames go on, each BLOCK[:START_S], with the number of the board's
        block; START_S counts from the first SYNC.
    seed
        Seed of the touches, of the noise, and of the choice of defective taxels and of patches that drift.
    """

    objects: ObjectNames = field(default_factory=list)
    stroke: StrokeKind = "slide"
    input: Path | None = None
    full_scale: FullScale = None
    array: ArrayNames = None
    rate: float | None = None
    defect: Annotated[
        list[str],
        Parameter(
            help="Defects, each KIND or KIND=AMOUNT, with the default amount in brackets. Those of sums need"
            f' taxels.frontend = "analogue". {_KINDS}'
        ),
    ] = field(default_factory=list)
    drift: list[str] = field(default_factory=list)
    frozen: list[str] = field(default_factory=list)
    seed: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the objects; none for the default series."""
        return object_names(self.objects)

    def check(self) -> None:
        """Check the options that need no layout."""
        if self.seed < 0:
            raise InputError(f"--seed: expected 0 or more, got {self.seed}")
        for flag, value in (("--array", self.array), ("--full-scale", self.full_scale), ("--rate", self.rate)):
            if self.input is None and value not in ([], None):
                raise InputError(f"{flag} is for a recording: give one with --input")
        if self.input is not None and (self.objects or self.stroke != "slide"):
            raise InputError("--objects and --stroke are for the simulator: a recording shows its own touches")

    def source(self, layout: Layout, rest_s: float = 0.0) -> TaxelSource:
        """Return the touch on a skin; simulated objects wait for `rest_s`."""
        if self.input is None:
            return load_objects(layout, names=self.names or None, stroke=self.stroke, seed=self.seed, rest_s=rest_s)
        taxels = layout.taxels
        return load_source(
            "recording",
            path=self.input,
            rows=taxels.rows,
            columns=taxels.columns,
            full_scale=self.full_scale,
            force_max_n=taxels.force_max_n,
            arrays=tuple(listed(self.array)) if self.array else None,
            rate_hz=step_rate_hz(layout),
            frame_rate_hz=self.rate,
        )

    def defects(self, layout: Layout) -> Defects:
        """Return the defects, drifts and frozen boards."""
        found = parse_defects(self.defect, self.drift, self.seed, layout)
        return replace(found, stops=parse_stops(self.frozen, layout))


NO_TOUCH_OPTIONS: Final = TouchOptions()
