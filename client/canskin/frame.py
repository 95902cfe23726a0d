"""One tactile frame: image, contacts, label and sums of one instant, gathered from their messages."""

import time
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Final, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.description import Description
from canskin.errors import InputError
from canskin.messages import UNKNOWN_ERROR_NS, Contact, Contacts, EndedContact, Image, Label, Measurement
from canskin.skin_clock import SkinClock, machine
from canskin.sums import corrected_counts, doubtful_taxels

#: Measurements, contacts and labels that wait for the image of their cycle.
_KEPT: Final = 32
#: Greatest age of a label's sums, relative to those of the frame that the label is put on.
LABEL_AGE_NS: Final = 500_000_000


Message = TypeVar("Message", Measurement, Contacts, Label)


@dataclass(frozen=True, eq=False)
class Frame:
    """What the skin felt at one instant. Arrays are read-only.

    Attributes
    ----------
    forces : array of float32, shape (n,)
        Newtons; NaN where the taxel is not measured. Taxels of a grid are row-major.
    estimate : array of float32, of `Description.shape`: (rows, columns), or (n,) where the skin is no grid
        Newtons: `forces`, with the solver's estimate from the neighbours where taxels are not measured.
    valid : array of bool, shape as `estimate`
        True where the taxel was measured: its block was, and it is not masked.
    doubtful : array of bool, shape as `estimate`
        True where the force may be an error of the zero, for example of a warm patch, and no touch.
    sums : array of int32, shape (m,)
        Counts less offsets, block by block; 0 where not in `valid_sums`. Empty if the measurement did not come.
    valid_sums : array of bool, shape (m,)
    contacts : tuple of Contact
        The strongest first. Empty without contact, and where `is_blind`. `Contact.doubtful` tells which may be errors
        of the zero, `Contact.doubtful_since_mono_ns` since when.
    ended : tuple of EndedContact
        Contacts that ended since the frame before.
    is_blind : bool
        True if it is not known whether something touches: no sum was valid, or no message of contacts came.
    label : str or None
        The touching object; empty without contact; None if the classifier did not tell, or had too few sums.
    confidence : float
        Of the label, 0 to 1.
    cycle : int
        Number of the measurement.
    sampled_at : float
        Wall clock at which the boards sampled, Unix time in seconds. NaN if the measurement did not come and none
        before.
    sampled_mono_ns : int
        The same on the monotonic clock of the gateway's machine.
    sampled_error_s : float
        Bound of the error of these times; infinite if unknown.
    """

    forces: npt.NDArray[np.float32]
    estimate: npt.NDArray[np.float32]
    valid: npt.NDArray[np.bool_]
    doubtful: npt.NDArray[np.bool_]
    sums: npt.NDArray[np.int32]
    valid_sums: npt.NDArray[np.bool_]
    contacts: tuple[Contact, ...]
    ended: tuple[EndedContact, ...]
    is_blind: bool
    label: str | None
    confidence: float
    cycle: int
    sampled_at: float
    sampled_mono_ns: int
    sampled_error_s: float
    _skin: Description = field(repr=False)
    _clock: SkinClock = field(default_factory=lambda: SkinClock(machine()), repr=False)

    @property
    def image(self) -> npt.NDArray[np.float32]:
        """The forces as a picture, shape (rows, columns).

        Raises
        ------
        InputError
            If the skin is no grid.
        """
        if not self._skin.is_grid:
            raise InputError(f"skin '{self._skin.name}' is no grid and has no image: use frame.forces, frame.positions")
        return self.forces.reshape(self._skin.shape)

    @property
    def positions(self) -> npt.NDArray[np.float32]:
        """Where the taxels of `forces` lie, metres, shape (n, 3): `Description.positions_m`."""
        return self._skin.positions_m

    @property
    def normals(self) -> npt.NDArray[np.float32]:
        """The directions out of the skin at the taxels of `forces`, shape (n, 3): `Description.unit_normals`."""
        return self._skin.unit_normals

    @property
    def age(self) -> float:
        """Seconds since the boards sampled; `age_error_s` bounds the error."""
        if self._clock.known()[1] == UNKNOWN_ERROR_NS:
            return time.time() - self.sampled_at
        return (self._clock.now_ns() - self.sampled_mono_ns) * 1e-9

    @property
    def age_error_s(self) -> float:
        """Bound of the error of `age` now: that of the sampling instant, and that of the clock of another machine.

        Infinite if the age is that of the wall clocks of two machines, because the gateway does not tell its time.
        """
        error_ns = self._clock.known()[1]
        return float("inf") if error_ns == UNKNOWN_ERROR_NS else self.sampled_error_s + error_ns * 1e-9


class FrameBuilder:
    """Joins messages to frames. Messages of one cycle have its number and its sampling instant.

    An image waits for its contacts, and at most for the next image.

    Attributes
    ----------
    refused : int
        Number of messages whose arrays do not fit the description.
    """

    def __init__(self, description: Description, clock: SkinClock | None = None) -> None:
        self.refused = 0
        self._about = description
        self._blocks = description.block_of_taxel
        self._block_of_sum = description.block_of_sum
        self._clock = clock or SkinClock(description.boot_id)
        self._measurements: OrderedDict[tuple[int, int], Measurement] = OrderedDict()
        self._labels: OrderedDict[tuple[int, int], Label] = OrderedDict()
        self._wall_offset_ns: int | None = None
        self._contacts: OrderedDict[tuple[int, int], Contacts] = OrderedDict()
        self._image: Image | None = None
        #: Whether the newest measurement is of another Φ than the description: no frames are made then.
        self.is_outdated = False

    def take(self, message: msgspec.Struct) -> list[Frame]:
        """Take a message, of any topic in any order; return the frames that it completes."""
        if isinstance(message, Measurement):
            self.is_outdated = message.fingerprint != self._about.fingerprint
            self._wall_offset_ns = message.wall_offset_ns
            _keep(self._measurements, message)
        elif isinstance(message, Label):
            _keep(self._labels, message)
        elif isinstance(message, Image):
            before, self._image = self._image, message
            frames = self._frames(before, None)
            contacts = self._contacts.pop(_key(message), None)  # each topic has a thread: contacts may be first
            if contacts is not None:
                self._image = None
                frames += self._frames(message, contacts)
            return frames
        elif isinstance(message, Contacts):
            if self._image is not None and _key(message) == _key(self._image):
                image, self._image = self._image, None
                return self._frames(image, message)
            _keep(self._contacts, message)
        return []

    def _frames(self, image: Image | None, contacts: Contacts | None) -> list[Frame]:
        about = self._about
        if image is None:
            return []
        if self.is_outdated or len(image.pixels) != 4 * about.rows * about.columns or len(image.valid) != about.blocks:
            self.refused += 1
            return []
        try:
            doubtful = doubtful_taxels(image, about.rows * about.columns)
        except InputError:
            self.refused += 1
            return []
        if doubtful is None:
            doubtful = np.zeros(about.rows * about.columns, np.bool_)
        estimate = np.frombuffer(image.pixels, "<f4").reshape(about.shape)
        valid = np.append(np.frombuffer(image.valid, np.uint8) != 0, False)[self._blocks]
        valid.flat[np.frombuffer(about.masked, "<u4")] = False
        forces = np.where(valid, estimate, np.float32(np.nan)).ravel()
        measurement = self._measurements.get(_key(image))
        sums, valid_sums = self._sums(measurement)
        for array in (valid, forces, doubtful, sums, valid_sums):
            array.flags.writeable = False
        label = self._label(image)
        offset_ns = self._wall_offset_ns
        return [
            Frame(
                forces=forces,
                estimate=estimate,
                valid=valid,
                doubtful=doubtful.reshape(about.shape),
                sums=sums,
                valid_sums=valid_sums,
                contacts=tuple(contacts.contacts) if contacts is not None else (),
                ended=tuple(contacts.ended) if contacts is not None else (),
                is_blind=contacts is None or contacts.blind,
                label=None if label is None else label.label,
                confidence=0.0 if label is None else label.confidence,
                cycle=image.cycle,
                sampled_at=float("nan") if offset_ns is None else (image.sampled_mono_ns + offset_ns) * 1e-9,
                sampled_mono_ns=image.sampled_mono_ns,
                sampled_error_s=float("inf")
                if image.sampled_error_ns == UNKNOWN_ERROR_NS
                else image.sampled_error_ns * 1e-9,
                _skin=about,
                _clock=self._clock,
            )
        ]

    def _label(self, image: Image) -> Label | None:
        """Return the label of the image's cycle, or else the newest one before that is not too old."""
        before = (each for each in self._labels.values() if each.sampled_mono_ns <= image.sampled_mono_ns)
        label = max(before, key=lambda each: each.sampled_mono_ns, default=None)
        if label is None or image.sampled_mono_ns - label.sampled_mono_ns > LABEL_AGE_NS:
            return None
        return label if label.is_measured(self._about.sums) else None

    def _sums(self, measurement: Measurement | None) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.bool_]]:
        """Return counts less offsets, and which of them are valid; empty if there is no measurement that fits."""
        about, nothing = self._about, (np.zeros(0, np.int32), np.zeros(0, np.bool_))
        if measurement is None:
            return nothing
        sizes = (len(measurement.sums), len(measurement.valid), measurement.fingerprint)
        parts = ((measurement.offsets, 4), (measurement.usable, 1))
        if sizes != (4 * about.sums, about.blocks, about.fingerprint) or any(
            len(part) not in {0, size * about.sums} for part, size in parts
        ):
            self.refused += 1
            return nothing
        valid = (np.frombuffer(measurement.valid, np.uint8) != 0)[self._block_of_sum]
        if measurement.usable:
            valid &= np.frombuffer(measurement.usable, np.uint8) != 0
        try:
            return corrected_counts(measurement, valid), valid
        except InputError:
            self.refused += 1
            return nothing


def _key(message: Measurement | Image | Contacts | Label) -> tuple[int, int]:
    return message.cycle, message.sampled_mono_ns


def _keep(kept: OrderedDict[tuple[int, int], Message], message: Message) -> None:
    """Keep a message, and forget the oldest."""
    kept[_key(message)] = message
    while len(kept) > _KEPT:
        kept.popitem(last=False)
