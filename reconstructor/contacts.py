"""Contacts: where the skin is touched, how strongly, and which touch is which from image to image.

A contact is a region of neighbouring taxels with force (`reconstructor.kernels.touched_regions`). From image to image:

* A region belongs to the contact whose taxels it covers.
* Two objects slide into each other: each taxel of their region keeps its contact, and the border between the contacts
  follows the valley between them. So both keep their identities, and have them when they part.
* A contact that has no peak of its own beside another one has joined it. When the other one parts, the piece is the
  contact that joined last.
* The regions of one touch often grow together after the onset: a contact younger than `JOIN_S` joins
  the oldest contact of its region for good.
* A contact without a region is remembered for `MEMORY_S`, so that one bad image does not end it.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import groupby
from operator import attrgetter
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import Contact, EndedContact
from reconstructor.kernels.touched_regions import (
    FEATURES,
    cut,
    give_owners,
    no_regions,
)
from shell.compiled import hold
from skin.surface import GRID_NORMAL, Surface

#: Taxels above `EDGE_N` newtons belong to a region. A contact begins when a taxel is above `ONSET_N`, and lasts while
#: a taxel is above `KEEP_N`.
EDGE_N: Final = 0.0005
KEEP_N: Final = 0.001
ONSET_N: Final = 0.002
#: A contact younger than this joins an older one that it meets.
JOIN_S: Final = 0.5
#: A contact has a peak of its own while its largest force is more than this times the force of the pass to the next.
PEAK_RATIO: Final = 1.05
#: How long a contact without a region is remembered, and how far from its last place it may come back, in pitches.
MEMORY_S: Final = 0.05
REACH: Final = 4.0
_NO_FLAGS: Final = np.empty(0, np.bool_)
#: Shorter means of normals are those of a touch all around, which has no direction.
LEAST_NORMAL: Final = 0.01
Point = tuple[float, float, float]


@dataclass(eq=False)
class _Track:
    """A contact from its onset to its end; `place`: its centre when it was last seen, without the normal."""

    identity: int
    onset_ns: int
    seen_ns: int = 0
    doubtful_ns: int = 0
    place: list[float] = field(default_factory=list)
    #: The contact that it has joined.
    host: "_Track | None" = None


#: A contact in an image, and what is known of it beyond the image.
Seen = tuple[Contact, _Track]


@dataclass(eq=False)
class _Part:
    """The taxels of a region that belong to one contact: a row of `cut`, with its region and its contact."""

    #: Its number, and those of the parts that have joined it.
    numbers: list[int]
    #: Sums of force x place.
    moments: list[float]
    region: int
    owner: int
    force_n: float
    peak_n: float
    taxels: float
    top: float
    bottom: float
    left: float
    right: float
    pass_n: float
    neighbour: float
    track: _Track | None = None

    def add(self, other: "_Part") -> None:
        """Take another part in."""
        self.force_n += other.force_n
        self.moments = [mine + its for mine, its in zip(self.moments, other.moments, strict=True)]
        self.peak_n = max(self.peak_n, other.peak_n)
        self.taxels += other.taxels
        self.top, self.bottom = min(self.top, other.top), max(self.bottom, other.bottom)
        self.left, self.right = min(self.left, other.left), max(self.right, other.right)
        self.numbers += other.numbers

    @property
    def centre(self) -> list[float]:
        """Row and column of the centre of force; its position in metres and normal where the skin is no grid."""
        return [each / self.force_n for each in self.moments]


class ContactTracker:
    """Finds the contacts of each image, and follows them.

    Parameters
    ----------
    surface : Surface
        Of the skin.

    Attributes
    ----------
    seen : list of (Contact, track)
        The contacts of the last image, for `adopt`.
    """

    def __init__(self, surface: Surface) -> None:
        self.seen: list[Seen] = []
        self._surface, count = surface, len(surface.positions_m)
        #: Of each taxel row and column, or position and normal where the skin is no grid.
        places, self._reach = np.hstack((surface.positions_m, surface.normals)), REACH * surface.pitch_m
        if surface.is_grid:
            places, self._reach = np.indices(surface.shape).reshape(2, count).T.astype(np.float64, "C"), REACH
        self._first_m = _point(surface.positions_m[0])
        #: The owner of a taxel is 1 + the place of its contact in `_tracks`.
        self._regions = no_regions(surface, places)
        self._held = hold(self._regions)
        self._tracks: list[_Track] = []
        self._lost: list[_Track] = []
        self._joined: list[_Track] = []
        self._ended: list[EndedContact] = []
        self._begun = 0
        self._now_ns = 0

    def take(
        self,
        image: npt.NDArray[np.floating],
        now_ns: int,
        valid: npt.NDArray[np.bool_] | None = None,
        doubtful: npt.NDArray[np.bool_] | None = None,
    ) -> tuple[list[Contact], list[EndedContact]]:
        """Return the contacts of the next image, the strongest first, and the contacts that have ended.

        Parameters
        ----------
        image : array of float, shape (rows, columns)
            Newtons.
        now_ns : int
            Time of the image, nanoseconds; never earlier than that of the image before.
        valid : array of bool, shape (rows, columns), optional
            Which taxels were measured; without it, all.
        doubtful : array of bool, shape (n,), optional
            Taxels whose force may be an error of the zero, row-major; without it, none.
        """
        if image.shape != self._surface.shape:
            raise InputError(f"expected an image of {self._surface.shape} taxels, got {image.shape}")
        if _is_over(self._now_ns, now_ns):
            self._lost += self._tracks
            self._tracks = []
            self._regions.owner[:] = 0
        self._now_ns, self._ended = now_ns, []
        parts = self._cut(image)
        self._assign(parts)
        kept = self._join(parts)
        kept.sort(key=attrgetter("force_n"), reverse=True)
        contacts = self._follow(kept, len(parts), image, valid, doubtful)
        self.seen = list(zip(contacts, self._tracks, strict=True))
        self._forget()
        return contacts, self._ended

    def adopt(self, seen: Sequence[Seen], contacts: Sequence[Contact]) -> None:
        """Give contacts the identities and onsets that another tracker, which began earlier, gives them.

        Contacts that the other one knows and that are in no image now, joined or lost, get new identities when they
        come again.

        Parameters
        ----------
        seen : list of (Contact, track)
            What `seen` was after an image.
        contacts : list of Contact
            The other one's, of an equal image.
        """
        left = {each.identity: each for each in contacts}
        taken, others = set(left), dict[_Track, Contact]()
        for own, track in seen:
            apart_m = {each: math.dist(left[each].position_m, own.position_m) for each in left}
            nearest = min(apart_m, key=apart_m.__getitem__, default=0)
            if nearest and apart_m[nearest] < self._surface.pitch_m:
                others[track] = left.pop(nearest)
        self._begun = max(self._begun, *taken, 0)
        for track in (*self._tracks, *self._lost, *self._joined):
            if other := others.get(track):
                track.identity, track.onset_ns = other.identity, other.onset_mono_ns
                track.doubtful_ns = track.doubtful_ns and other.doubtful_since_mono_ns
            elif track.identity in taken:
                self._begun += 1
                track.identity = self._begun

    def warm_up(self) -> None:
        """Compile the kernels, or take them from the cache; before the first image."""
        ContactTracker(self._surface).take(np.full(self._surface.shape, 0.01, np.float32), 0)

    def _cut(self, image: npt.NDArray[np.floating]) -> list[_Part]:
        """Cut the image into parts, one for each pair of region and earlier contact."""
        table = cut(image, EDGE_N, KEEP_N, self._held)
        rows = zip(self._regions.pairs[: len(table)].tolist(), table.tolist(), strict=True)
        return [_Part([number], row[FEATURES:], *pair, *row[:FEATURES]) for number, (pair, row) in enumerate(rows, 1)]

    def _assign(self, parts: list[_Part]) -> None:
        """Give each part its contact: the earlier one to its strongest part, to the others one remembered or new."""
        gone = dict(enumerate(self._tracks, 1))
        free = []
        for part in sorted(parts, key=attrgetter("force_n"), reverse=True):
            part.track = gone.pop(part.owner, None)
            if part.track is None and part.peak_n > ONSET_N:
                free.append(part)
        self._lost += gone.values()
        for part in free:
            part.track = self._parted(part) or self._remembered(part) or self._new()

    def _parted(self, part: _Part) -> _Track | None:
        """Take the contact that joined the owner of this part last."""
        host = self._tracks[part.owner - 1] if part.owner else None
        for track in reversed(self._joined if host else ()):
            if track.host is host:
                self._joined.remove(track)
                return track
        return None

    def _remembered(self, part: _Part) -> _Track | None:
        """Take the nearest lost contact within reach."""
        place = part.centre[:3]
        apart = [math.dist(each.place, place) for each in self._lost]
        if not apart or min(apart) > self._reach:
            return None
        return self._lost.pop(apart.index(min(apart)))

    def _place(self, centre: list[float]) -> tuple[float, float, Point, Point]:
        """Return row and column of a centre of force, and its position and normal.

        Where the skin is no grid, the column is the nearest taxel.
        """
        surface = self._surface
        if surface.is_grid:
            row, column = centre
            x_m, y_m, z_m = self._first_m
            return row, column, (x_m + column * surface.pitch_m, y_m + row * surface.pitch_m, z_m), GRID_NORMAL
        position_m, normal = np.array(centre[:3]), np.array(centre[3:])
        length = float(np.linalg.norm(normal))
        apart_m = np.linalg.norm(surface.positions_m - position_m, axis=1)
        nearest = int(np.where(surface.normals @ normal >= 0, apart_m, np.inf).argmin())
        unit = normal / length if length > LEAST_NORMAL else surface.normals[nearest]
        return 0.0, float(nearest), _point(position_m), _point(unit)

    def _new(self) -> _Track:
        self._begun += 1
        return _Track(self._begun, self._now_ns)

    def _join(self, parts: list[_Part]) -> list[_Part]:
        """Join the parts of a region that are one contact; return what is left, without parts of no contact."""
        of_number = {number: part for part in parts for number in part.numbers}
        kept = []
        for _, group in groupby(sorted(parts, key=attrgetter("region")), attrgetter("region")):
            region = list(group)
            oldest = min(region, key=_age)
            if oldest.track is None:
                continue
            for part in sorted(region, key=attrgetter("peak_n")):
                host = self._host(part, oldest, of_number.get(int(part.neighbour)))
                if host is None:
                    kept.append(part)
                else:
                    self._give(part, host, may_part=host is not oldest or not self._is_young(part))
                    of_number.update(dict.fromkeys(part.numbers, host))
        return kept

    def _host(self, part: _Part, oldest: _Part, neighbour: _Part | None) -> _Part | None:
        """Return the part that this one joins, if any."""
        if part is not oldest and self._is_young(part):
            return oldest
        has_peak = part.peak_n > PEAK_RATIO * part.pass_n
        return None if has_peak or neighbour is part else neighbour

    def _is_young(self, part: _Part) -> bool:
        return part.track is None or self._now_ns - part.track.onset_ns < 1e9 * JOIN_S

    def _give(self, part: _Part, host: _Part, *, may_part: bool) -> None:
        """Join a part to another one."""
        host.add(part)
        track, part.track = part.track, None
        if track is None or host.track is None:
            return
        if track.seen_ns:
            self._ended.append(EndedContact(track.identity, track.onset_ns, self._now_ns, host.track.identity))
        if may_part:
            track.host = host.track
            self._joined.append(track)

    def _follow(
        self,
        parts: list[_Part],
        count: int,
        image: npt.NDArray[np.floating],
        valid: npt.NDArray[np.bool_] | None,
        doubtful: npt.NDArray[np.bool_] | None,
    ) -> list[Contact]:
        """Note where each contact is now, and return the contacts.

        Parameters
        ----------
        count : int
            Number of parts before some were joined.
        """
        contacts: list[Contact] = []
        self._tracks = []
        if not count:
            return contacts
        owner_of_part, table = np.zeros(count + 1, np.int32), np.empty((len(parts) + 1, 2))
        for place, part in enumerate(parts, 1):
            owner_of_part[part.numbers] = place
        measured = _NO_FLAGS if valid is None else valid.ravel()
        give_owners(owner_of_part, image, measured, _NO_FLAGS if doubtful is None else doubtful, self._held, table)
        for part, (invalid_taxels, of_it_n) in zip(parts, table[1:].tolist(), strict=True):
            track = part.track or self._new()
            centre = part.centre
            track.seen_ns, track.place = self._now_ns, centre[:3]
            row, column, position_m, normal = self._place(centre)
            track.doubtful_ns = (track.doubtful_ns or self._now_ns) if 2 * of_it_n >= part.force_n else 0
            self._tracks.append(track)
            contacts.append(
                Contact(
                    identity=track.identity,
                    row=row,
                    column=column,
                    force_n=part.force_n,
                    peak_n=part.peak_n,
                    taxels=int(part.taxels),
                    top=int(part.top),
                    bottom=int(part.bottom),
                    left=int(part.left),
                    right=int(part.right),
                    onset_mono_ns=track.onset_ns,
                    invalid_taxels=int(invalid_taxels),
                    doubtful_since_mono_ns=track.doubtful_ns,
                    position_m=position_m,
                    normal=normal,
                )
            )
        return contacts

    def _forget(self) -> None:
        """End the contacts that have been without a region for too long, and forget those that had joined them."""
        over = [each for each in self._lost if _is_over(each.seen_ns, self._now_ns)]
        self._lost = [each for each in self._lost if each not in over]
        self._ended += [EndedContact(each.identity, each.onset_ns, each.seen_ns) for each in over]
        alive = {each.identity for each in (*self._tracks, *self._lost, *self._joined)}
        self._joined = [each for each in self._joined if each.host and each.host.identity in alive]


def _age(part: _Part) -> tuple[float, int]:
    """Sort the oldest contact first, parts without a contact last."""
    return (part.track.onset_ns, part.track.identity) if part.track else (float("inf"), 0)


def _is_over(seen_ns: int, now_ns: int) -> bool:
    """Tell whether a contact that was last seen at a time is forgotten now."""
    return now_ns - seen_ns > 1e9 * MEMORY_S


def _point(numbers: npt.NDArray[np.float64]) -> Point:
    x, y, z = numbers.tolist()
    return x, y, z
