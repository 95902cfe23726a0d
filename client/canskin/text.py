"""Text from other programs, as one line that a terminal, a log, a page or ROS can show.

Texts of messages are escaped when the message is made, at the sender and again at the receiver: whoever prints them,
or a user's own program, cannot forget to.
"""

from functools import cache
from typing import Final, get_args

import msgspec

#: Most characters of a text of a message.
TEXT_MAX: Final = 4096


def plain(text: str) -> str:
    """Return a text of at most `TEXT_MAX` characters, with escapes for those that do not print, such as line ends."""
    text = text[:TEXT_MAX]
    if text.isprintable():
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode() for each in text)


class Told(msgspec.Struct, frozen=True):
    """Base of the messages with texts: its fields with ``str`` are `plain`."""

    def __post_init__(self) -> None:
        for name in _texts(type(self)):
            given = getattr(self, name)
            if isinstance(given, str) and (told := plain(given)) != given:
                msgspec.structs.force_setattr(self, name, told)
            elif isinstance(given, list):
                msgspec.structs.force_setattr(self, name, [plain(each) for each in given])


@cache
def _texts(kind: type[msgspec.Struct]) -> tuple[str, ...]:
    return tuple(each.name for each in msgspec.structs.fields(kind) if str in (each.type, *get_args(each.type)))
