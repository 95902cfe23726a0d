"""Numbers of CiA 301 and of the contract as C: ``contract.h``, the same for all boards of all skins."""

from enum import IntEnum, IntFlag
from typing import Final

from dbc import board_sums, canopen, frame, indices
from dbc.dictionary import REACTION_NS
from firmware import tables
from firmware.c_text import header

#: Enumerations, and what the names of their members begin with.
_ENUMERATIONS: Final[dict[str, type[IntEnum | IntFlag]]] = {
    "": canopen.NmtState,
    "NMT_": canopen.NmtCommand,
    "ABORT_": canopen.Abort,
    "EMERGENCY_": canopen.Emergency,
    "REGISTER_": canopen.ErrorRegister,
}
_FRAME_FLAGS: Final = ("EXTENDED", "REMOTE", "ERROR", "FD", "BRS", "ECHO")
_OBJECT_FLAGS: Final = ("WRITABLE", "MAPPABLE", "COVERED", "TEXT", "COMPUTED")
_PATTERNS: Final = ("PATTERN_OFF", "PATTERN_ZERO", "PATTERN_RAMP", "PATTERN_FULL")


def contract_header() -> str:
    """Return ``contract.h``: the names of the Python modules, with ``SKIN_`` before them."""
    numbers: dict[str, int] = {
        **_whole(indices),
        **_whole(canopen),
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
    ]
    return header("CONTRACT_H", "Numbers of CiA 301 and of all skins.", lines)


def _whole(module: object) -> dict[str, int]:
    """Return the constants of a module that are whole numbers."""
    return {name: value for name, value in vars(module).items() if name.isupper() and type(value) is int}
