"""What the gateway tells of the zero of its skin, and what it can be asked for."""

from enum import Enum
from typing import Final, Literal

import msgspec

from canskin.question import Question


class CalibrationState(str, Enum):
    """Where the zero of a skin comes from."""

    __str__ = str.__str__  # the value, as `enum.StrEnum` of Python 3.11 has it

    #: There is none, and none is measured; nodes with adaptive sending have their own.
    OFF = "off"
    #: It is being measured.
    MEASURING = "measuring"
    #: Something touches the skin: its zero will be measured when it is untouched. Stored offsets are used meanwhile.
    TOUCHED = "touched"
    #: It was measured, and is followed while it drifts.
    FOLLOWING = "following"
    #: It was stored, and stays as it is.
    LOADED = "loaded"


class CalibrationStatus(msgspec.Struct, frozen=True, kw_only=True):
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
    """

    state: CalibrationState
    tared_mono_ns: int = 0
    known_sums: int = 0
    offset_rms_n: float = 0.0
    drift_rms_n_per_s: float = 0.0
    noise_n: float = 0.0
    held_blocks: int = 0
    defects: list[str] = []
    revision: int = 0


class CalibrationRequest(msgspec.Struct, frozen=True, kw_only=True):
    """What a program asks the gateway for.

    Attributes
    ----------
    action : str
        ``tare``: measure the zero; ``show``: tell it; ``load``: use another; ``write``: write it to the nodes.
    force : bool
        Of ``tare``: whatever touches the skin is part of its zero.
    content : bytes
        Of ``load`` and ``write``: a file of `calibration.stored`.
    """

    action: Literal["tare", "show", "load", "write"]
    force: bool = False
    content: bytes = b""


class CalibrationReply(msgspec.Struct, frozen=True, kw_only=True):
    """The gateway's answer.

    Attributes
    ----------
    is_done : bool
        Whether all that was asked for was done.
    text : str
        The result in words.
    status : CalibrationStatus or None
    content : bytes
        Of ``show``: the calibration as a file of `calibration.stored`.
    """

    is_done: bool
    text: str
    status: CalibrationStatus | None = None
    content: bytes = b""


CALIBRATION: Final = Question("calibration", CalibrationRequest, CalibrationReply)
#: Longest wait for an answer, but for that to ``write``: a zero takes seconds.
ANSWER_S: Final = 15.0
