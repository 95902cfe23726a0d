"""Faults as data: type, probability, and the controllers and frames concerned."""

import contextlib
from collections.abc import Sequence
from fnmatch import fnmatchcase
from random import Random
from typing import Annotated, Final, NamedTuple

import msgspec

from canskin.errors import InputError

#: Longest delay: longer than any cycle, and far below the limit of times in 64 bits.
DELAY_MAX_S: Final = 3600.0

Ratio = Annotated[float, msgspec.Meta(ge=0, le=1)]


class Fault(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One fault; if several faults match a frame, the largest value of each field counts.

    Attributes
    ----------
    controller : str
        Pattern of controller names ``STATION:PORT``, with shell wildcards.
    can_id, mask : int
        Frames with ``identifier & mask == can_id & mask``. Mask 0 matches every frame.
    loss_ratio : float
        Probability that a sent and acknowledged frame reaches no receiver (overrun of the receive buffer).
    duplicate_ratio : float
        Probability of an error in the last bit of end of frame: receivers accept the frame, and it is sent again.
    delay_ratio, delay_s : float
        Probability of a delay, and time from end of frame to the receivers.
    bit_error_rate : float
        Probability of an error per bit: an error frame follows, and the frame is sent again.
    off : bool
        The controller has no power; `can_id` and `mask` have no effect.
    """

    controller: str = "*"
    can_id: int = 0
    mask: int = 0
    loss_ratio: Ratio = 0.0
    duplicate_ratio: Ratio = 0.0
    delay_ratio: Ratio = 0.0
    delay_s: Annotated[float, msgspec.Meta(ge=0, le=DELAY_MAX_S)] = 0.0
    bit_error_rate: Ratio = 0.0
    off: bool = False


class Odds(NamedTuple):
    """Probabilities of the faults of one frame."""

    loss: float
    duplicate: float
    delay: float
    delay_ns: int
    bit_error: float


class FaultSchedule:
    """The faults, looked up once per controller and identifier, and their random numbers.

    Parameters
    ----------
    seed : int
        The same seed and the same frames give the same faults.
    """

    def __init__(self, faults: Sequence[Fault] = (), seed: int = 0) -> None:
        self._faults = tuple(faults)
        self._random = Random(seed)
        self._duplicated: set[int] = set()
        self._known: dict[tuple[str, int], Odds] = {}

    def __bool__(self) -> bool:
        return bool(self._faults)

    def is_off(self, controller: str) -> bool:
        """Tell whether `controller` has no power."""
        return any(fault.off and fnmatchcase(controller, fault.controller) for fault in self._faults)

    def odds(self, controller: str, can_id: int) -> Odds:
        """Return the probabilities of faults of a frame of `controller` with `can_id`."""
        odds = self._known.get((controller, can_id))
        if odds is None:
            if len(self._known) >= 65536:  # a flood of random 29-bit identifiers must not fill the memory
                self._known.clear()
            odds = self._known[controller, can_id] = self._combine(controller, can_id)
        return odds

    def draw(self, probability: float) -> bool:
        """Draw whether an event of this probability happens."""
        return probability > 0 and self._random.random() < probability

    def draw_error_ns(self, odds: Odds, duration_ns: int, bitrate: int) -> int | None:
        """Draw the time from start of frame to the first disturbed bit; None for no error."""
        intact = (1 - odds.bit_error) ** (duration_ns * bitrate / 1e9)
        if intact < 1 and self._random.random() >= intact:
            return self._random.randrange(duration_ns)
        return None

    def draw_duplicate(self, odds: Odds, sequence: int) -> bool:
        """Draw whether frame number `sequence` is sent twice; each frame is repeated at most once."""
        if sequence not in self._duplicated and self.draw(odds.duplicate):
            self._duplicated.add(sequence)
            return True
        self._duplicated.discard(sequence)
        return False

    def _combine(self, controller: str, can_id: int) -> Odds:
        rules = [
            fault
            for fault in self._faults
            if fnmatchcase(controller, fault.controller) and not (can_id ^ fault.can_id) & fault.mask
        ]
        return Odds(
            loss=max((rule.loss_ratio for rule in rules), default=0.0),
            duplicate=max((rule.duplicate_ratio for rule in rules), default=0.0),
            delay=max((rule.delay_ratio for rule in rules), default=0.0),
            delay_ns=max((round(rule.delay_s * 1e9) for rule in rules), default=0),
            bit_error=max((rule.bit_error_rate for rule in rules), default=0.0),
        )


def parse_fault(text: str) -> Fault:
    """Read a fault from ``KEY=VALUE[,KEY=VALUE…]``, numbers decimal or 0x…; raise InputError for any other text."""
    fields: dict[str, object] = {}
    for part in filter(None, text.split(",")):
        key, equals, value = part.partition("=")
        fields[key.strip()] = _value(value.strip()) if equals else True
    try:
        fault = msgspec.convert(fields, Fault, strict=False)
    except msgspec.ValidationError as error:
        keys = ", ".join(Fault.__struct_fields__)
        raise InputError(f"fault '{text}': {error}; expected KEY=VALUE,… with keys {keys}") from error
    delay = fault.delay_ratio * fault.delay_s
    if not (fault.loss_ratio or fault.duplicate_ratio or delay or fault.bit_error_rate or fault.off):
        raise InputError(f"fault '{text}': does nothing: commas join its keys, and a delay has a ratio and a time")
    return fault


def _value(text: str) -> object:
    """Read hexadecimal numbers; the rest is left to the fields' types."""
    with contextlib.suppress(ValueError):
        if text.lower().startswith("0x"):
            return int(text, 16)
    return text
