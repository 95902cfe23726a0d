"""What a reconstructor that stands by learns of the one that publishes: it goes on with the same numbers.

Both solve the same sums, so their images are equal but for rounding some cycles after the younger one's start. What
depends on all images since the start comes with the published contacts: the number of the image, and the identities of
the contacts.
"""

from collections import deque
from typing import Any, Final, NamedTuple

from canskin.fabric import Exchange, Mailbox
from canskin.messages import CONTACTS, Contacts, EndedContact
from reconstructor.contacts import ContactTracker, Seen

#: Own images that wait for the published contacts of their cycles.
_PAST: Final = 64


class _Past(NamedTuple):
    cycle: int
    number: int
    seen: list[Seen]
    ended: list[EndedContact]


class Following:
    """Compares the contacts of images that were not published with those that another reconstructor has published.

    Attributes
    ----------
    ahead : int
        Number that the other one would give an image, less the own number.
    """

    def __init__(self, tracker: ContactTracker, fabric: Exchange) -> None:
        self.ahead = 0
        self._tracker, self._fabric = tracker, fabric
        self._published: Mailbox[Any] | None = None  # most reconstructors are alone, and never follow
        self._newest: Contacts | None = None
        self._past: deque[_Past] = deque(maxlen=_PAST)

    def follow(self, made: Contacts, number: int) -> None:
        """Take the contacts of an own image that is not published, and its own number."""
        if self._published is None:
            self._published = self._fabric.mailbox(CONTACTS, 1)
        self._past.append(_Past(made.cycle, number, self._tracker.seen, made.ended))
        self._newest = self._published.get(0.0) or self._newest
        if self._newest is None:
            return
        while self._past and self._past[0].cycle <= self._newest.cycle:
            past = self._past.popleft()
            if past.cycle == self._newest.cycle:
                self.ahead = self._newest.number - past.number if self._newest.number else 0
                self._tracker.adopt(past.seen, self._newest.contacts)
                self._newest = None
                return

    def take_over(self) -> list[EndedContact]:
        """Return the contacts that have ended since the newest image that was published."""
        ended = [each for past in self._past for each in past.ended]
        self._past.clear()
        return ended
