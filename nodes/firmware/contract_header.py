"""Numbers of CiA 301, of the contract and of filters as C: ``contract.h``, the same for all boards of all skins."""

from enum import IntEnum, IntFlag
from typing import Final

import numpy as np

from dbc import averaging, board_sums, canopen, frame, indices, program, slots
from dbc.contract import LONGEST_VALUE
from dbc.dictionary import REACTION_NS
from dbc.patch_filter import LEAST_EXPONENT, LEAST_WEIGHT, LOG2_E, POWER
from nodes.firmware import tables
from nodes.firmware.c_text import braced, defined, double, header, real
from skin.clipping import IDLE_DEVIATION, IDLE_MEAN, REACH, clipped_mean

#: Enumerations, and what the names of their members begin with.
_ENUMERATIONS: Final[dict[str, type[IntEnum | IntFlag]]] = {
    "": canopen.NmtState,
    "NMT_": canopen.NmtCommand,
    "LSS_": canopen.Lss,
    "LSS_ERROR_": canopen.LssError,
    "ABORT_": canopen.Abort,
    "EMERGENCY_": canopen.Emergency,
    "REGISTER_": canopen.ErrorRegister,
    "PROGRAM_": program.ProgramControl,
    "FLASH_": program.FlashError,
    "RECORD_": slots.Record,
}
_FRAME_FLAGS: Final = ("EXTENDED", "REMOTE", "ERROR", "FD", "BRS", "ECHO")
_OBJECT_FLAGS: Final = ("WRITABLE", "MAPPABLE", "COVERED", "CALIBRATING", "COMPUTED")
_PATTERNS: Final = ("PATTERN_OFF", "PATTERN_ZERO", "PATTERN_RAMP", "PATTERN_FULL")
#: Indices of the object dictionary; the other numbers of `indices` are data types, signatures and a stride.
_INDICES: Final = range(0x1000, 0x3000)
#: Points of the table that undoes the bias of clipping in averages.
_CLIPPED_POINTS: Final = 129


def contract_header() -> str:
    """Return ``contract.h``: the names of the Python modules, with ``SKIN_`` before them."""
    numbers: dict[str, int] = {
        **{f"OD_{name}" if number in _INDICES else name: number for name, number in whole_numbers(indices).items()},
        **whole_numbers(canopen),
        **whole_numbers(program),
        **whole_numbers(slots),
        "LONGEST_VALUE": LONGEST_VALUE,
        **{start + each.name: each for start, kind in _ENUMERATIONS.items() for each in kind if each.name},
        **{f"FRAME_{name}": getattr(frame, name) for name in _FRAME_FLAGS},
        **{f"OBJECT_{name}": getattr(tables, name) for name in _OBJECT_FLAGS},
        **{name: getattr(board_sums, name) for name in _PATTERNS},
    }
    restricted = (f"{{0x{each.start:X}, 0x{each.stop - 1:X}}}" for each in canopen.RESTRICTED_COB_IDS)
    lines = [
        f"#define SKIN_REACTION_NS {REACTION_NS}",
        *(f"#define SKIN_{name} 0x{value:X}u" for name, value in numbers.items()),
        f"#define SKIN_RESTRICTED_COB_IDS {{{', '.join(restricted)}}}",
        f"#define SKIN_FD_LENGTHS {{{', '.join(map(str, frame.FD_LENGTHS))}}}",
        *defined(_filters()),
    ]
    return header("CONTRACT_H", "Numbers of CiA 301, and of all skins.", lines)


def _filters() -> dict[str, tuple[object, str]]:
    """Return the numbers of filters that all boards share, and of those that average."""
    clipped = clipped_mean(np.linspace(0, REACH, _CLIPPED_POINTS))
    return {
        "SKIN_IDLE_MEAN": (double(IDLE_MEAN), "mean of noise N(0, 1) that is clipped at 0"),
        "SKIN_IDLE_DEVIATION": (double(IDLE_DEVIATION), "and its deviation"),
        "SKIN_LEAST_WEIGHT": (real(LEAST_WEIGHT), "of a filter"),
        "SKIN_LOG2_E": (real(LOG2_E), "1 / ln 2"),
        "SKIN_LEAST_EXPONENT": (real(LEAST_EXPONENT), "of a likelihood"),
        "SKIN_POWER": (braced(map(real, POWER)), "polynomial of 2^f"),
        "SKIN_MEMORY": (averaging.MEMORY, "samples over which the noise of a taxel is learned"),
        "SKIN_ROUNDING": (real(averaging.ROUNDING), "variance of rounding to whole counts"),
        "SKIN_OUTLIER_RATIO": (real(averaging.OUTLIER_RATIO), "most of a squared second difference, over their mean"),
        "SKIN_IDLE_BAND": (real(averaging.IDLE_BAND), "of mean over deviation of an idle taxel"),
        "SKIN_EVENNESS": (real(averaging.EVENNESS), "least of size over square of second differences"),
        "SKIN_IDLE_TAXELS": (
            round(1 / averaging.IDLE_PART),
            "1 / part of the taxels that are idle where noise is learned",
        ),
        "SKIN_LEARNING_GAIN": (real(averaging.LEARNING_GAIN), "part of the difference that noise follows"),
        "SKIN_AVERAGE_DEAD_RATIO": (real(averaging.DEAD_RATIO), "deviations of an average: a force of fewer is 0"),
        "SKIN_CLIPPED_REACH": (real(REACH), "end of the table of the mean of x + N(0, 1) clipped at 0, x from 0"),
        "SKIN_CLIPPED_POINTS": (_CLIPPED_POINTS, "of this table"),
        "SKIN_CLIPPED_MEAN": (braced(map(real, clipped), per_line=8), "the table"),
    }


def whole_numbers(module: object) -> dict[str, int]:
    """Return the constants of a module that are whole numbers."""
    return {name: value for name, value in vars(module).items() if name.isupper() and type(value) is int}
