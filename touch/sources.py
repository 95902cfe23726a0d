"""The taxel sources of this package, registered as entry points of the group ``canskin.sources``."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from canskin.errors import InputError
from recording import is_recording
from shell.service import say
from skin.ranges import listed, require_above_zero, require_number
from skin.sources import DEFAULT_OBJECTS, Frame, StrokeKind
from skin.surface import Surface
from skin.taxel import FORCE_MAX_N
from touch.contact import PITCH_M, Force, Pose, Skin, skin_of
from touch.objects import checked_names
from touch.random_touches import felt_objects
from touch.reading import array_names, read_counts
from touch.recording import Recording
from touch.strokes import LABEL_FORCE_N, LIVE, PAUSE_S, SLOT_S, Touch, draw_touch, random_stream

#: Most other arrays of a file that the log names.
NAMED: Final = 8
#: Part of the largest force above which the rest of a recording is told.
HIGH_REST: Final = 0.25
#: Objects are pressed at about this rate; at the steps of a higher rate forces are interpolated.
POSES_HZ: Final = 100.0


class ObjectSource:
    """An endless random series of touches, object after object; a `skin.sources.TaxelSource`.

    The first touch begins after `rest_s`. Each takes `touch.strokes.SLOT_S`: pause, press, hold, slide (if `stroke` is
    that), lift. A frame has the object's name as label while its largest true force is at least
    `touch.strokes.LABEL_FORCE_N`. Above 150 steps a second, objects are pressed at every second, third, ... step, and
    forces between are interpolated.
    """

    has_noise = False

    def __init__(
        self,
        skin: Skin,
        rate_hz: float,
        names: Sequence[str],
        seed: int,
        *,
        rest_s: float = 0.0,
        stroke: StrokeKind = "slide",
    ) -> None:
        self._rest_steps = round(rest_s * rate_hz)
        self.skin = skin
        self.rate_hz = rate_hz
        self.names = tuple(names)
        self._seed = seed
        self._stroke = stroke
        self._index = -1
        self._stride = max(1, round(rate_hz / POSES_HZ))
        self._newest: dict[int, Frame] = {}
        self._touch: Touch | None = None
        self._pressed: tuple[int, Pose] | None = None
        self._force_n = self._untouched = _fixed(np.zeros(skin.shape, np.float32))

    def touch(self, index: int) -> Touch:
        """Return touch number `index`, from 0."""
        if self._touch is None or index != self._index:
            name = self.names[index % len(self.names)]
            self._touch = draw_touch(name, self.skin, random_stream(self._seed, LIVE, index), self._stroke)
            self._index = index
        return self._touch

    def frame(self, step: int) -> Frame:
        """Return the frame at `step`; its array is read-only."""
        if step < 0:
            raise InputError(f"a source starts at step 0: got {step}")
        whole, part = divmod(step, self._stride)
        before = self._posed(whole * self._stride)
        if not part:
            return before
        after = self._posed((whole + 1) * self._stride)
        if after.force_n is before.force_n:
            return before
        force_n = _fixed(before.force_n + np.float32(part / self._stride) * (after.force_n - before.force_n))
        return Frame(force_n, self._label(force_n, before.label or after.label))

    def _posed(self, step: int) -> Frame:
        """Return the frame at a step at which the object is pressed; of the newest two it is known."""
        frame = self._newest.get(step)
        if frame is None:
            frame = self._press(step)
            self._newest = {**dict(list(self._newest.items())[-1:]), step: frame}
        return frame

    def _press(self, step: int) -> Frame:
        index, time_s = divmod(max(0, step - self._rest_steps) / self.rate_hz, SLOT_S)
        if time_s <= PAUSE_S:
            return Frame(self._untouched, "")
        touch = self.touch(int(index))
        pose = touch.stroke.pose(time_s - PAUSE_S)
        if (self._index, pose) != self._pressed:  # a held object has the same image for many steps
            self._force_n = _fixed(touch.force_n(self.skin, pose))
            self._pressed = self._index, pose
        return Frame(self._force_n, self._label(self._force_n, touch.name))

    @staticmethod
    def _label(force_n: Force, name: str) -> str:
        return name if float(force_n.max()) >= LABEL_FORCE_N else ""


def objects(
    rows: int = 64,
    columns: int = 64,
    pitch_m: float = PITCH_M,
    rate_hz: float = 100.0,
    *,
    surface: Surface | None = None,
    names: Sequence[str] | None = None,
    seed: int = 0,
    rest_s: float = 0.0,
    stroke: StrokeKind = "slide",
) -> ObjectSource:
    """Return an endless series of touches by simulated objects.

    Parameters
    ----------
    rows, columns : int
        Taxels of the skin.
    pitch_m : float
        Distance between neighbouring taxels.
    rate_hz : float
        Steps per second.
    surface : Surface, optional
        Where the taxels lie, of a skin that is no grid.
    names : sequence of str, optional
        Objects of the catalogue, in the order of their touches; a string may hold several names, separated by commas.
        Default: the objects of `skin.sources.DEFAULT_OBJECTS` that this skin can feel.
    seed : int
        The same seed gives the same touches.
    rest_s : float
        Time without touch at the beginning.
    stroke : {"slide", "press"}
        See `skin.sources.StrokeKind`.
    """
    require_number("rest_s", rest_s)
    require_above_zero("rate_hz", rate_hz)
    require_number("seed", seed)
    skin = skin_of(rows, columns, pitch_m, surface)
    listed = felt_objects(DEFAULT_OBJECTS, skin) if names is None else checked_names(names)
    source = ObjectSource(skin, rate_hz, listed, seed, rest_s=rest_s, stroke=stroke)
    # Compile the contact kernel now, not inside a cycle.
    source.frame(int(np.ceil((rest_s + (PAUSE_S + SLOT_S) / 2) * rate_hz)))
    return source


def recording(
    path: str | Path,
    rows: int = 64,
    columns: int = 64,
    rate_hz: float | None = None,
    *,
    full_scale: float | None = None,
    force_max_n: float = FORCE_MAX_N,
    arrays: Sequence[str] | None = None,
    frame_rate_hz: float | None = None,
) -> Recording:
    """Return a recording as a taxel source; after its last frame the first follows.

    Parameters
    ----------
    path : str or pathlib.Path
        ``.npz``, ``.npy`` (arrays of shape (time, rows, columns)) or ``.mcap``, see `touch.reading.read_counts`.
    rows, columns : int
        Taxels of the skin; a smaller recording is placed in the middle, and the log tells.
    rate_hz : float, optional
        Steps per second of the skin; needed only with `frame_rate_hz`.
    full_scale : float, optional
        The recorded value that becomes `force_max_n`; default: the largest value of the recording, which is the
        attribute `full_scale` of the source. A ``.mcap`` holds newtons, which stay as they are by default.
    force_max_n : float
        Force at full scale, newtons.
    arrays : sequence of str, optional
        Arrays of an ``.npz`` or ``.mcap`` to place side by side, left to right; a string may hold several names,
        separated by commas. Default: the first array in the file; the log names the others.
    frame_rate_hz : float, optional
        Recorded frames per second; default: each step shows the next frame.
    """
    if frame_rate_hz is not None and (rate_hz is None or not 0.0 < frame_rate_hz < float("inf")):
        raise InputError(
            f"a recording's rate (--rate) needs a number above 0, and the skin's: got {frame_rate_hz}, {rate_hz}"
        )
    named = tuple(listed([arrays])) if isinstance(arrays, str) else arrays
    counts = read_counts(Path(path), named)
    if named is None:
        _tell_others(Path(path))
    if full_scale is None and is_recording(Path(path)):
        full_scale = force_max_n
    played = Recording(
        counts,
        rows,
        columns,
        full_scale=full_scale,
        force_max_n=force_max_n,
        steps_per_frame=1.0 if frame_rate_hz is None or rate_hz is None else rate_hz / frame_rate_hz,
    )
    if played.shape != (rows, columns):
        high, wide = played.shape
        say(
            "recording",
            f"{high} x {wide} taxels of {Path(path).name} lie in the middle of a skin of {rows} x {columns}:"
            f" the taxels around them feel nothing",
        )
    if (rest := played.rest_n) > HIGH_REST * force_max_n:
        say(
            "recording",
            f"{Path(path).name} is high at rest: half of its values are played as {1e3 * rest:.3g} mN or more, of"
            f" {1e3 * force_max_n:.3g} mN. A sensor that reads high at rest plays its rest as force: take the rest off",
        )
    return played


def _tell_others(path: Path) -> None:
    """Log which of several arrays is played: the user may want another array."""
    first, *others = array_names(path) or ("",)
    if others:
        more = f" and {len(others) - NAMED} more" if len(others) > NAMED else ""
        also = f"{', '.join(others[:NAMED])}{more}"
        say("recording", f"plays the array {first} of {path.name}; choose with --array, there is also {also}")


def _fixed(force_n: Force) -> Force:
    force_n.flags.writeable = False
    return force_n
