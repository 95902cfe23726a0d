"""The list of holders: which certificates an authority has issued, and which of them count no longer."""

from pathlib import Path
from typing import Final

import msgspec

from canskin.errors import UNDECODABLE, InputError, reasoned

#: The list, beside the authority, and copied into the folder of the hub's keys.
HOLDERS: Final = "holders.json"


class Holders(msgspec.Struct):
    """What an authority has issued, by common name: ``SKIN:ROLE`` or ``SKIN:ROLE:HOLDER``.

    Attributes
    ----------
    skin : str
        Name of the skin that is meant where none is named.
    hosts : list of str
        Names and addresses of the hub's machine.
    until : dict of str to str
        The day on which the newest certificate of each holder ends, YYYY-MM-DD.
    revoked : list of str
    """

    skin: str
    hosts: list[str]
    until: dict[str, str] = {}
    revoked: list[str] = []

    @property
    def allowed(self) -> list[str]:
        """The common names that count: the hub lets in no other."""
        return [name for name in self.until if name not in self.revoked]


def read_holders(folder: Path) -> Holders:
    """Return the list that a folder has, that of an authority or of the hub's keys; InputError if there is none."""
    path = folder / HOLDERS
    expected = f"{path}: expected the list that 'skin keys new' makes, beside the authority and in the hub's keys"
    with reasoned(InputError, expected):
        content = path.read_bytes()
    try:
        return msgspec.json.decode(content, type=Holders)
    except UNDECODABLE as error:
        raise InputError(f"{expected}: {error}") from error
