"""Messages of other devices on the buses of a skin, as the layout or a .dbc names them."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec

from canskin.errors import LayoutError
from skin.limits import TEXT_BYTES_MAX, read_text

#: Identifiers of 11 and of 29 bits end here.
BASE_ID_MAX: Final = 0x7FF
EXTENDED_ID_MAX: Final = 0x1FFF_FFFF
#: Payloads of CAN FD beyond those of classic CAN, bytes (ISO 11898-1).
FD_ONLY_LENGTHS: Final = (12, 16, 20, 24, 32, 48, 64)
CLASSIC_MAX: Final = 8


class ForeignMessage(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One message of another device.

    `period_s` is the least time from one frame to the next. A message without a period is no part of a plan; its
    identifier counts as known, and none of the skin may have it. One that `is_split` has none: J1939 sends its more
    than 8 bytes in frames of other identifiers.
    """

    name: Annotated[str, msgspec.Meta(min_length=1, max_length=128)]
    identifier: Annotated[int, msgspec.Meta(ge=0, le=EXTENDED_ID_MAX)]
    is_extended: bool = False
    length: Annotated[int, msgspec.Meta(ge=0, le=FD_ONLY_LENGTHS[-1])] = CLASSIC_MAX
    fd: bool = False
    period_s: Annotated[float, msgspec.Meta(ge=1e-4, le=86_400.0)] | None = None
    is_split: bool = False
    # The .dbc that names the message, and its line; it fills this in.
    origin: str | None = None

    @property
    def label(self) -> str:
        """The name for messages of errors, with the .dbc that has it."""
        return f"'{self.name}' of {self.origin}" if self.origin else f"'{self.name}'"

    @property
    def key(self) -> tuple[int, bool]:
        """What tells the message from others on the bus."""
        return self.identifier, self.is_extended

    @property
    def rank(self) -> float:
        """Order in arbitration, the lowest first: the 11 upper bits decide, and then an identifier of 11 bits wins."""
        return self.identifier / 2**18 + 2**-20 if self.is_extended else float(self.identifier)


def with_foreign_dbc(bus: dict[str, Any], folder: Path) -> None:
    """Put the messages of the .dbc that a table of a bus names in place of its name, after those of the table."""
    if isinstance(bus.get("foreign_dbc"), str) and isinstance(bus.setdefault("foreign", []), list):
        bus["foreign"] = [*bus["foreign"], *_read_dbc(folder / bus.pop("foreign_dbc"))]


def _read_dbc(path: Path) -> list[dict[str, Any]]:
    from cantools.database.can import Database

    database = Database(strict=False)
    text = read_text(path, LayoutError, "the messages", TEXT_BYTES_MAX)
    try:
        database.add_dbc_string(text)
    except Exception as error:  # of cantools, of its parser, of int
        words = " ".join(str(error).split())
        found = (_line(text, rf"\d+\s+{re.escape(each)}") for each in re.findall(r"in message (\w+)", words))
        raise LayoutError(f"{path}{next(found, '')}: expected a .dbc: {words}") from error
    return [
        _message(each, path.name + _line(text, str(each.frame_id | each.is_extended_frame << 31)))
        for each in database.messages
    ]


def _line(text: str, pattern: str) -> str:
    """Return the line of a message in the text of a .dbc, in words."""
    found = re.search(rf"^[ \t]*BO_\s+{pattern}\b", text, re.MULTILINE)
    return f", line {text.count(chr(10), 0, found.start()) + 1}" if found else ""


def _message(each: Any, origin: str) -> dict[str, Any]:
    """Return a message of a .dbc as a table of the layout; LayoutError if no bus can have it."""
    is_split = each.is_extended_frame and not each.is_fd and each.length > CLASSIC_MAX
    if isinstance(each.cycle_time, str):
        raise LayoutError(f"{origin}: message '{each.name}': expected a period in ms, got '{each.cycle_time}'")
    table = {
        "name": each.name,
        "origin": origin,
        "identifier": each.frame_id,
        "is_extended": each.is_extended_frame,
        "length": CLASSIC_MAX if is_split else each.length,
        "fd": each.is_fd,
        "is_split": is_split,
        **({"period_s": each.cycle_time / 1e3} if each.cycle_time and not is_split else {}),
    }
    try:
        msgspec.convert(table, ForeignMessage)
    except msgspec.ValidationError as error:
        raise LayoutError(f"{origin}: message '{each.name}': {error}") from error
    return table


def check_foreign(messages: Sequence[ForeignMessage], path: str, *, is_fd: bool) -> None:
    """Check the messages of a bus; `path` is their place in the layout."""
    known: dict[object, ForeignMessage] = {}
    for index, each in enumerate(messages):
        place = f"at `{path}[{index}]`"
        if not each.is_extended and each.identifier > BASE_ID_MAX:
            limit = f"expected an identifier up to {BASE_ID_MAX} (7FFh), or `is_extended = true`"
            raise LayoutError(f"{limit}, got {each.identifier} for {each.label} - {place}")
        if each.fd and not is_fd:
            raise LayoutError(f"{each.label} is CAN FD: the bus needs `fd = true` - {place}")
        if each.length > CLASSIC_MAX and not (each.fd and each.length in FD_ONLY_LENGTHS):
            longer = ", ".join(map(str, FD_ONLY_LENGTHS))
            limits = f"expected a length of 0 to {CLASSIC_MAX}, or with `fd = true` of {longer}"
            raise LayoutError(f"{limits}, got {each.length} for {each.label} - {place}")
        for key, what in ((each.key, f"identifier {each.identifier:X}h"), (each.name, "name")):
            if (other := known.setdefault(key, each)) is not each:
                raise LayoutError(f"{other.label} and {each.label} have the same {what} - {place}")
