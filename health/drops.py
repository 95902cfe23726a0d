"""Which services miss messages, from what they tell of themselves."""

from typing import Final

from canskin.messages import ServiceStatus

#: A service drops until it has missed nothing for this time.
DROPS_S: Final = 3.0
#: Most processes kept; the one with the oldest status goes first.
PROCESSES: Final = 256


class Drops:
    """Notices when a service begins to miss messages. Times are those of the caller's clock."""

    def __init__(self) -> None:
        #: By process: its service, messages missed so far, messages missed before it began to, when, and when last.
        self._known: dict[str, tuple[str, int, int, float, float]] = {}

    def take(self, status: ServiceStatus, now_s: float) -> None:
        """Use what a service tells."""
        missed = status.missed + status.overruns
        _, last, begin, since_s, last_s = self._known.pop(status.instance, ("", missed, missed, now_s, -DROPS_S))
        if now_s - last_s >= DROPS_S:
            begin, since_s = last, now_s
        if missed > last:
            last_s = now_s
        self._known[status.instance] = status.service, missed, begin, since_s, last_s
        while len(self._known) > PROCESSES:
            del self._known[next(iter(self._known))]

    def of(self, service: str, now_s: float) -> tuple[int, float]:
        """Return how many messages the processes of a service have missed since they began to, and since when."""
        found = [each for each in self._known.values() if each[0] == service and now_s - each[4] < DROPS_S]
        return sum(each[1] - each[2] for each in found), min((each[3] for each in found), default=now_s)
