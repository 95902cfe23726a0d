"""Labelled touches of recordings: what a classifier of real touches is trained on."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError, tell
from canskin.messages import MEASUREMENT, MIN_VALID_RATIO
from classifier.model import Float64
from classifier.modelfile import skin_of
from classifier.newest_sums import NewestSums, averaged_cycles
from classifier.samples import FeatureExtractor, Observations, Untouched, observe_untouched, standard_untouched
from classifier.touches import CycleKey, Touches, read_touches
from classifier.used_sums import classified_phi, coarse_sums
from recording import RECORDING_SUFFIX, file_of, is_recording
from recording.mcap_file import Warn, read_messages
from skin.difference import difference
from skin.layout import Layout, load_layout
from skin.measured_sums import decode_measurement, decode_stepped
from skin.phi import Phi, places
from skin.taxel import NOISE_N

#: Cycles of one touch that are used, spread over its time: cycles beside each other are nearly equal.
MOST_PER_TOUCH: Final = 40
#: Cycles of the untouched skin that are used, and the fewest for a contact threshold of their own.
MOST_STILL: Final = 5000
LEAST_STILL: Final = 250
#: Draws of a simulated untouched skin in their place.
_DRAWN_STILL: Final = 5000
#: Means of fewer cycles than the classifier averages are left out, by the ratio of their noise.
_MOST_NOISE_RATIO: Final = 1.1


@dataclass(frozen=True, eq=False)
class LabelledTouches:
    """Cycles of labelled touches, with the features of each.

    Attributes
    ----------
    labels : array of str, shape (count,)
        Name of the touching object.
    touch, recording : array of int, shape (count,)
        Number of the touch among all touches, and of its recording in `files`. Cycles of one touch are nearly equal:
        these are the groups of a cross-validation.
    sums : array of float, shape (count, m)
        Sums less their offsets, ADC counts, as the classifier averages them; 0 where a block is missing.
    energies : array of float64, shape (count, 2 widths)
        Features that do not depend on the place of the touch (`classifier.features`).
    files : tuple of str
        Names of the recordings.
    layout, phi : Layout, Phi
        The skin, and Φ of the sums.
    seen : Observations
        The sums with their conditions.
    untouched : Untouched
        The untouched skin.
    still : int
        Number of recorded cycles of the untouched skin; 0 if they were too few, and are simulated.
    unlabelled : int
        Number of touches without a label: they are not used.
    """

    labels: npt.NDArray[np.str_]
    touch: npt.NDArray[np.intp]
    recording: npt.NDArray[np.intp]
    energies: Float64
    files: tuple[str, ...]
    layout: Layout
    phi: Phi
    seen: Observations
    untouched: Untouched
    still: int
    unlabelled: int

    @property
    def sums(self) -> npt.NDArray[Any]:
        """The sums."""
        return self.seen.sums

    @property
    def extractor(self) -> FeatureExtractor:
        """What computes the features of these cycles, by their number."""
        return FeatureExtractor(self.layout, self.phi, self.untouched.no_touch, self.seen)

    def whole(self) -> "LabelledTouches":
        """Return the cycles without a missing block."""
        rows = np.flatnonzero(self.seen.valid[:, self.phi.has_sums].all(axis=1))
        per_cycle = {name: getattr(self, name)[rows] for name in ("labels", "touch", "recording", "energies")}
        return replace(self, **per_cycle, seen=self.seen.part(rows))


def labelled_touches(
    recordings: Sequence[str | Path] | str | Path,
    layout: Path | None = None,
    *,
    noise_n: float = NOISE_N,
    seed: int = 0,
) -> LabelledTouches:
    """Read the labelled touches of recordings of one skin.

    Parameters
    ----------
    recordings : path or sequence of paths
        Recordings (.mcap) with measurements and contacts, or folders of them.
    layout : pathlib.Path, optional
        TOML of the skin; default: that of the first recording.
    noise_n : float
        Standard deviation of the taxel noise in newtons, for the untouched skin if the recordings hold fewer than
        `LEAST_STILL` cycles of it, or boards send steps.
    """
    given = [recordings] if isinstance(recordings, str | Path) else recordings
    paths = recordings_in(Path(each) for each in given)
    skin = load_layout(layout or paths[0])
    phi = classified_phi(skin)
    wanted = skin_of(skin, phi)
    for path in paths:
        own = load_layout(path)
        if differs := difference(skin_of(own, classified_phi(own)), wanted, "recording"):
            raise InputError(f"{path}: a recording of another skin than {layout or paths[0]} ({differs}): leave it out")
    readers = [_Reader(path, skin, phi, lambda line: tell("train", line), len(paths)) for path in paths]
    seen, still = (_joined([getattr(each, name) for each in readers], phi) for name in ("seen", "still"))
    has_still = skin.sends.in_cycles and len(still.sums) >= LEAST_STILL
    untouched = (
        standard_untouched(still, skin, phi)
        if has_still
        else observe_untouched(skin, phi, noise_n, _DRAWN_STILL, np.random.default_rng(seed))
    )
    first = np.cumsum([0, *(each.touches for each in readers)])
    extractor = FeatureExtractor(skin, phi, untouched.no_touch, seen)
    return LabelledTouches(
        labels=np.array([name for each in readers for name in each.labels], np.str_),
        touch=np.concatenate([each.touch + number for each, number in zip(readers, first[:-1], strict=True)]),
        recording=np.repeat(np.arange(len(readers)), [len(each.labels) for each in readers]),
        energies=extractor.features(seen.sums, np.zeros(len(seen.sums), np.intp), np.random.default_rng(seed)),
        files=tuple(each.name for each in paths),
        layout=skin,
        phi=phi,
        seen=seen,
        untouched=untouched,
        still=len(still.sums) if has_still else 0,
        unlabelled=sum(each.unlabelled for each in readers),
    )


def recordings_in(given: Iterable[Path]) -> list[Path]:
    """Return recordings, those of a folder in the order of their names."""
    paths = []
    for each in given:
        found = sorted(each.glob(f"*{RECORDING_SUFFIX}")) if each.is_dir() else [each]
        if not found or not all(file_of(path).is_file() and is_recording(path) for path in found):
            raise InputError(f"{each}: expected a recording of 'skin record' ({RECORDING_SUFFIX}), or a folder of them")
        paths += found
    if not paths:
        raise InputError("no recording named: expected one or more, or a folder of them")
    return list({path.resolve(): path for path in paths}.values())  # a run that is named twice is one run


class _Reader:
    """Reads one recording.

    Attributes
    ----------
    seen, still : list of tuple
        Rows of `Observations`: of labelled touches, and of the untouched skin.
    labels : list of str
        Label of each of `seen`.
    touch : array of int
        Number of its touch in this recording, from 0.
    touches, unlabelled : int
        Number of touches, and of those without label.
    """

    def __init__(self, path: Path, layout: Layout, phi: Phi, warn: Warn, recordings: int) -> None:
        found = read_touches(path, warn)
        self.touches, self.unlabelled = len(found.touches), sum(not each.label for each in found.touches)
        self.seen: list[tuple[Any, ...]] = []
        self.still: list[tuple[Any, ...]] = []
        self.labels: list[str] = []
        of_touch: list[int] = []
        wanted = _wanted(found, MOST_STILL // recordings)
        newest = NewestSums(phi, averaged_cycles(layout))
        sent = layout.operator()
        used = np.arange(phi.shape[0]) if layout.sends.in_cycles else places(layout.phi(), coarse_sums(layout))
        before = None
        for _, _, measurement in read_messages(path, (MEASUREMENT,), warn):
            try:
                decoded = (decode_measurement if layout.sends.in_cycles else decode_stepped)(measurement, sent)
            except InputError as error:
                raise InputError(f"{path}: {error}") from error
            step = 1
            if layout.sends.in_cycles and before is not None:
                step = measurement.cycle - before
            before = measurement.cycle
            ratio = newest.take(decoded.counts[used], decoded.valid, step)
            touch = wanted.get(CycleKey(measurement.cycle, measurement.sampled_mono_ns))
            if touch is None or ratio < MIN_VALID_RATIO or newest.noise_ratio > _MOST_NOISE_RATIO:
                continue
            one = (newest.sums.astype(np.float32), newest.valid.copy(), newest.noise_ratio, measurement.cycle)
            if touch < 0:
                self.still.append(one)
            else:
                self.seen.append(one)
                self.labels.append(found.touches[touch].label)
                of_touch.append(touch)
        self.touch = np.array(of_touch, np.intp)
        if before is None:
            raise InputError(
                f"{path}: holds contacts, but no sums for the classifier: expected a recording of 'skin record'"
            )


def _wanted(found: Touches, most_still: int) -> dict[CycleKey, int]:
    """Return the cycles that are used, with the place of their touch in `found.touches`, -1 for the untouched skin."""
    wanted = dict.fromkeys(_thinned(found.untouched, most_still), -1)
    for place, touch in enumerate(found.touches):
        if touch.label:
            wanted |= dict.fromkeys(_thinned(touch.cycles, MOST_PER_TOUCH), place)
    return wanted


def _thinned(keys: Sequence[CycleKey], most: int) -> list[CycleKey]:
    if len(keys) <= most:
        return list(keys)
    return [keys[place] for place in np.linspace(0, len(keys) - 1, most).round().astype(int)]


def _joined(parts: Sequence[Sequence[tuple[Any, ...]]], phi: Phi) -> Observations:
    rows = [row for part in parts for row in part]
    sums, valid, noise_ratio, cycle = zip(*rows, strict=True) if rows else ((), (), (), ())
    return Observations(
        np.array(sums, np.float32).reshape(-1, phi.shape[0]),
        np.array(valid, np.float32).reshape(-1, phi.blocks),
        np.array(noise_ratio, np.float64),
        np.array(cycle, np.int64),
    )
