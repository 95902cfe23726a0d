"""What the gateway tells of the zero of its skin, and what it can be asked for."""

from collections import Counter
from collections.abc import Sequence
from enum import Enum, IntEnum
from typing import Final, Literal

import msgspec
import numpy as np

from canskin.errors import InputError
from canskin.question import Question
from canskin.text import Told

#: First row, first column, last row and last column of a part of the skin; both last ones belong to it.
Region = tuple[int, int, int, int]


class CalibrationState(str, Enum):
    """Where the zero of a skin comes from."""

    __str__ = str.__str__  # the value, as `enum.StrEnum` of Python 3.11 has it

    #: There is none, and none is measured; nodes with steps have their own, and none is doubted.
    OFF = "off"
    #: It is being measured.
    MEASURING = "measuring"
    #: Something touches the skin: its zero will be measured when it is untouched. Stored offsets are used meanwhile.
    TOUCHED = "touched"
    #: It was measured, and is followed while it drifts, by the nodes with steps.
    FOLLOWING = "following"
    #: It was stored, and stays as it is.
    LOADED = "loaded"


class ZeroSupport(IntEnum):
    """What the zero of a block rests on, the weakest first."""

    #: No zero is known: sums come as they are.
    NONE = 0
    #: It is of an earlier run, a file or stepped nodes themselves, and was not confirmed since.
    STORED = 1
    #: It has moved since because of forces below zero, and was not confirmed by an untouched stretch.
    CORRECTED = 2
    #: A person said so: ``skin tare --force`` or ``--region``. That counts until forces below zero show otherwise.
    TOLD = 3
    #: It was measured in an untouched stretch.
    MEASURED = 4


class CalibrationStatus(Told, frozen=True, kw_only=True):
    """Offsets and noise of the sums.

    Attributes
    ----------
    tared_mono_ns : int
        When the zero was measured; 0 for never.
    known_sums : int
        Number of sums with an offset.
    offset_rms_n, drift_rms_n_per_s, noise_n : float
        Of these sums: offsets and their present drift, root mean square; median noise of one cycle.
    held_blocks : int
        Blocks that are touched now: their offsets are not measured.
    defects : list of str
        Defective sums, taxels and blocks in words.
    revision : int
        Number of zeros measured, calibrations loaded and writings to nodes since the start of the gateway.
    zero_support : bytes
        uint8, shape (blocks,): `ZeroSupport`. Empty if unknown.
    zero_mono_ns : bytes
        int64, shape (blocks,): when the zero of the block was last measured or told; 0 for never.
    recalibrated : list of str
        Nodes whose gains or offsets have become others without the gateway, and which nobody has accepted since: all
        their forces are doubtful.
    doubtful_taxels : int
        Taxels whose force may be an error of the zero or of gains, see `canskin.messages.Measurement.doubtful`.
    doubtful_force_n : float
        Force on them.
    doubtful_since_mono_ns : int
        Since when there are such taxels; 0: there are none.
    told_mono_ns : int
        When the gateway told this; 0 for unknown.
    """

    state: CalibrationState
    tared_mono_ns: int = 0
    known_sums: int = 0
    offset_rms_n: float = 0.0
    drift_rms_n_per_s: float = 0.0
    noise_n: float = 0.0
    held_blocks: int = 0
    defects: list[str] = msgspec.field(default_factory=list)
    revision: int = 0
    zero_support: bytes = b""
    zero_mono_ns: bytes = b""
    recalibrated: list[str] = msgspec.field(default_factory=list)
    doubtful_taxels: int = 0
    doubtful_force_n: float = 0.0
    doubtful_since_mono_ns: int = 0
    told_mono_ns: int = 0

    @property
    def oldest_zero_s(self) -> float | None:
        """Age of the oldest zero that was measured or told, seconds; None if unknown."""
        times_ns = np.frombuffer(self.zero_mono_ns[: len(self.zero_mono_ns) // 8 * 8], "<i8")
        times_ns = times_ns[times_ns > 0]
        return (self.told_mono_ns - int(times_ns.min())) * 1e-9 if times_ns.size and self.told_mono_ns else None

    @property
    def zero_words(self) -> str:
        """How many blocks have a zero of which support, and the age of the oldest; empty if unknown or off."""
        if self.state is CalibrationState.OFF and not any(self.zero_support):
            return ""
        counts, oldest_s = Counter(self.zero_support), self.oldest_zero_s
        words = ", ".join(f"{counts[each]} {each.name.lower()}" for each in reversed(ZeroSupport) if counts[each])
        return words if not words or oldest_s is None else f"{words}; oldest {oldest_s:.0f} s"

    @property
    def doubtful_words(self) -> str:
        """How many taxels are doubtful, with how much force, for how long; empty without any."""
        if not self.doubtful_taxels:
            return ""
        since_s = (self.told_mono_ns - self.doubtful_since_mono_ns) * 1e-9
        for_s = f" for {since_s:.0f} s" if self.told_mono_ns and self.doubtful_since_mono_ns else ""
        return f"{self.doubtful_taxels}, with {self.doubtful_force_n:.3g} N{for_s}"


class CalibrationRequest(Told, frozen=True, kw_only=True):
    """What a program asks the gateway for.

    Attributes
    ----------
    action : str
        ``tare``: measure the zero; ``load``: use another; ``write``: write it to the nodes.
    force : bool
        Of ``tare``: whatever touches the skin is part of its zero.
    region : tuple of int, or str, optional
        Of ``tare``: first row, first column, last row, last column, both included, or the name of a region of the
        layout. Whatever stands there now is part of its zero; the rest of the skin keeps its zero.
    content : bytes
        Of ``load`` and ``write``: a file of `skin.calibration_file`.
    """

    action: Literal["tare", "load", "write"]
    force: bool = False
    region: Region | str | None = None
    content: bytes = b""


class ZeroRequest(msgspec.Struct, frozen=True):
    """Asks for the zero, and changes nothing."""


class CalibrationReply(Told, frozen=True, kw_only=True):
    """The gateway's answer.

    Attributes
    ----------
    is_done : bool
        Whether all that was asked for was done.
    text : str
        The result in words.
    status : CalibrationStatus or None
    content : bytes
        Of `ZERO`: the calibration as a file of `skin.calibration_file`.
    """

    is_done: bool
    text: str
    status: CalibrationStatus | None = None
    content: bytes = b""


#: Changes the zero.
CALIBRATION: Final = Question("calibration", CalibrationRequest, CalibrationReply)
#: Tells the zero. The rules of the hub see names of questions alone: hence two.
ZERO: Final = Question("zero", ZeroRequest, CalibrationReply)
#: Longest wait for an answer, but for that to ``write``: a zero takes seconds.
ANSWER_S: Final = 15.0


def tare_request(
    rows: int, columns: int, *, force: bool = False, region: Sequence[object] | str | None = None
) -> CalibrationRequest:
    """Return a request for a new zero of a skin of `rows` by `columns` taxels.

    Parameters
    ----------
    region : sequence of int or str, or str, optional
        See `CalibrationRequest`; numbers or their texts, or a name.

    Raises
    ------
    InputError
        If the region is not on the skin, or has no four whole numbers, or is named together with `force`.
    """
    if region is None:
        return CalibrationRequest(action="tare", force=force)
    if force:
        raise InputError("a tare of a region, and by force: expected one of both")
    if isinstance(region, str):
        return CalibrationRequest(action="tare", region=region)
    try:
        top, left, bottom, right = (int(str(each)) for each in region)
    except ValueError:
        top, left, bottom, right = -1, -1, -1, -1
    if not (0 <= top <= bottom < rows and 0 <= left <= right < columns):
        raise InputError(
            f"region {','.join(map(str, region))[:64]}: expected first row, first column, last row and last column,"
            f" rows of 0 to {rows - 1} and columns of 0 to {columns - 1}"
        )
    return CalibrationRequest(action="tare", region=(top, left, bottom, right))
