"""Who publishes, where several services make the same of a skin's sums: each measurement names one of them.

The gateway alone gives out cycles, so no cycle has two images or labels. The others stand by: they make all that the
named one makes, and publish nothing. The name changes when the token of the named one goes, when nothing comes from it
for `SILENCE_S` while measurements go out, or when another has had less to do for some seconds.
"""

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import partial
from typing import Final

from canskin.fabric import Fabric, Origin
from canskin.messages import CONTACTS, LABEL, SERVICES, ServiceStatus
from canskin.peers import Peer

#: The services of which one publishes, and the smallest message that comes with each of its results.
RESULTS: Final = {"reconstructor": CONTACTS, "classifier": LABEL}
#: The named one is replaced when nothing has come from it for this time, or for this number of its results' processor
#: times: a slow machine does not stand still. After twice this time it is replaced also by one that may stand still.
SILENCE_S: Final = 0.15
SILENCE_RESULTS: Final = 4.0
#: A gateway that has not looked for this time was late itself.
LATE_S: Final = 0.05
#: A service that has told nothing of itself for this time can be named no more.
FIT_S: Final = 2.5
#: Another one is named that has this much less to do, of one core, in `BETTER_TIMES` statuses of the named one; the
#: lower instance, which is drawn, where both have as much: so several skins do not all have the same one.
LIGHTER_RATIO: Final = 0.25
BETTER_TIMES: Final = 5


@dataclass
class _Candidate:
    """A service that can be named; `keys` are its tokens."""

    instance: str
    heard_s: float
    keys: set[str] = field(default_factory=set)
    load_ratio: float = 0.0
    made: int | None = None
    #: Processor time of a result.
    cost_s: float = 0.0
    works: bool = True

    def take(self, status: ServiceStatus, now_s: float) -> None:
        """Take what the service tells of itself."""
        if self.made is not None:
            more = status.made - self.made
            self.works = more > 0
            self.cost_s = status.load_ratio * (now_s - self.heard_s) / max(1, more)
        self.heard_s, self.made, self.load_ratio = now_s, status.made, status.load_ratio

    def is_fit(self, now_s: float) -> bool:
        """Tell whether the service lives, and makes something of the measurements."""
        return self.works and now_s - self.heard_s < FIT_S

    def is_better(self, than: "_Candidate") -> bool:
        """Tell whether to name this one in place of another."""
        less = than.load_ratio - self.load_ratio
        return less > LIGHTER_RATIO or (self.instance < than.instance and abs(less) < LIGHTER_RATIO / 2)


class Duty:
    """Names one of the instances of a service.

    Parameters
    ----------
    service : str
        Its name.
    tell : callable
        Is called with each change, in words.

    Attributes
    ----------
    named : str
        The instance; empty while there is none.
    """

    def __init__(self, service: str, tell: Callable[[str], None]) -> None:
        self.named = ""
        self._service, self._tell = service, tell
        self._candidates: dict[str, _Candidate] = {}
        self._better = 0
        #: When the oldest measurement went out that the named one may owe a result.
        self._owed_since_s: float | None = None

    @property
    def is_shared(self) -> bool:
        """Whether there are two or more."""
        return len(self._candidates) > 1

    def note(self, peer: Peer, is_there: bool, now_s: float) -> None:
        """Note that a token came or went."""
        candidate = self._candidates.setdefault(peer.instance, _Candidate(peer.instance, now_s))
        (candidate.keys.add if is_there else candidate.keys.discard)(peer.key)
        if not candidate.keys:
            del self._candidates[peer.instance]
        if not self.named or self.named not in self._candidates:
            self._name(self._best(now_s, self._candidates.values()), "has left")

    def came(self, instance: str, _now_s: float = 0.0) -> None:
        """Note a result."""
        if instance == self.named:
            self._owed_since_s = None

    def told(self, status: ServiceStatus, now_s: float) -> None:
        """Note what an instance tells of itself."""
        candidate = self._candidates.get(status.instance)
        if candidate is None:
            return
        candidate.take(status, now_s)
        if status.instance == self.named:
            best = self._best(now_s, [each for each in self._candidates.values() if each.is_better(candidate)])
            self._better = self._better + 1 if best is not None and best.is_fit(now_s) else 0
            if self._better >= BETTER_TIMES:
                self._name(best, "has more to do")

    def sent(self, now_s: float) -> None:
        """Note that a measurement goes out."""
        if self._owed_since_s is None:
            self._owed_since_s = now_s

    def begin(self, now_s: float) -> None:
        """Begin to wait and to judge anew: nothing was heard until now, or this gateway was late."""
        self._owed_since_s = None
        for each in self._candidates.values():
            each.heard_s = now_s

    def look(self, now_s: float) -> None:
        """Name another one if nothing has come for too long."""
        named = self._candidates.get(self.named)
        if named is None or self._owed_since_s is None:
            return
        silent_s, patience_s = now_s - self._owed_since_s, max(SILENCE_S, SILENCE_RESULTS * named.cost_s)
        others = [each for each in self._candidates.values() if each is not named]
        fit = [each for each in others if each.is_fit(now_s)]
        if silent_s > (patience_s if fit else 2 * patience_s):
            named.works = False  # until it tells of more results
            self._name(self._best(now_s, others), f"has sent nothing for {silent_s:.2f} s")

    def _best(self, now_s: float, among: Iterable[_Candidate]) -> _Candidate | None:
        def rank(each: _Candidate) -> tuple[bool, float, str]:
            return not each.is_fit(now_s), each.load_ratio // LIGHTER_RATIO, each.instance

        return min(among, key=rank, default=None)

    def _name(self, candidate: _Candidate | None, why: str) -> None:
        before, self.named = self.named, "" if candidate is None else candidate.instance
        self._owed_since_s, self._better = None, 0
        if self.named and before not in {"", self.named}:
            self._tell(f"{self._service} {self.named} publishes: {before} {why}")


class Duties:
    """Names who publishes the results of a skin's measurements, for the loop of its gateway.

    The messages of others come in threads of the fabric, and wait for the next turn of the loop. While a service is
    there once, nothing of its results is received.

    Parameters
    ----------
    fabric : Fabric
        Of the gateway.
    skin, fingerprint : str
        Those of the `canskin.peers.Peer` that can be named.
    tell : callable
        Is called with each change, in words.

    Attributes
    ----------
    words : str
        What measurements tell, see `canskin.messages.Measurement.duty`.
    """

    def __init__(self, fabric: Fabric, skin: str, fingerprint: str, tell: Callable[[str], None]) -> None:
        self._duties = {service: Duty(service, tell) for service in RESULTS}
        self.words = self._words()
        self._fabric, self._own = fabric, (skin, fingerprint)
        self._news: deque[Callable[[float], None]] = deque()
        #: What ends the subscriptions of each service that is there twice.
        self._ends: dict[str, tuple[Callable[[], None], ...]] = {}
        self._looked_s = float("inf")
        fabric.watch_peers(self._note)

    def sent(self, now_s: float) -> None:
        """Note that a measurement goes out."""
        for service in self._ends:
            self._duties[service].sent(now_s)

    def turn(self, now_s: float) -> None:
        """Take what has come, and name others where one is silent."""
        was_late, self._looked_s = now_s - self._looked_s > LATE_S, now_s
        if not self._news and not self._ends:
            return
        while self._news:
            self._news.popleft()(now_s)
        for service, duty in self._duties.items():
            if duty.is_shared != (service in self._ends):
                self._listen(service, duty)
                duty.begin(now_s)
            elif was_late:
                duty.begin(now_s)
            elif service in self._ends:
                duty.look(now_s)
        self.words = self._words()

    def _words(self) -> str:
        return " ".join(f"{service}={duty.named}" for service, duty in self._duties.items())

    def _note(self, peer: Peer, is_there: bool) -> None:
        if peer.service in RESULTS and (peer.skin, peer.fingerprint) == self._own:
            self._news.append(partial(self._duties[peer.service].note, peer, is_there))

    def _listen(self, service: str, duty: Duty) -> None:
        """Receive the results of a service, and what it tells of itself, while it is there twice."""

        def came(_content: bytes, origin: Origin | None) -> None:
            if origin is not None:
                self._news.append(partial(duty.came, origin.publisher))

        def told(status: ServiceStatus) -> None:
            self._news.append(partial(duty.told, status))

        for end in self._ends.pop(service, ()):
            end()
        if duty.is_shared:
            ends = self._fabric.subscribe_bytes(RESULTS[service], came), self._fabric.subscribe(SERVICES, told)
            self._ends[service] = ends
