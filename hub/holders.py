"""The list of holders: which certificates an authority has issued, and which of them count no longer."""

from pathlib import Path
from typing import Final

import msgspec

from canskin.errors import InputError, reasoned

#: The list, beside the authority, and copied into the folder of the hub's keys.
HOLDERS: Final = "holders.json"


class Holder(msgspec.Struct):
    """A certificate.

    Attributes
    ----------
    until : str
        The day on which the certificate ends, YYYY-MM-DD.
    is_revoked : bool
    """

    until: str
    is_revoked: bool = False


class Holders(msgspec.Struct):
    """What an authority has issued.

    Attributes
    ----------
    skin : str
        Name of the skin that is meant where none is named.
    hosts : list of str
        Names and addresses of the hub's machine.
    holders : dict of str to Holder
        By common name, ``SKIN:ROLE`` or ``SKIN:ROLE:HOLDER``.
    """

    skin: str
    hosts: list[str]
    holders: dict[str, Holder] = {}

    @property
    def allowed(self) -> list[str]:
        """The common names that count, revoked ones left out: the hub lets in no other."""
        return [name for name, each in self.holders.items() if not each.is_revoked]


def read_holders(folder: Path) -> Holders:
    """Return the list that a folder has: that of an authority, or of the hub's keys.

    Raises
    ------
    InputError
        If there is no list, or it cannot be read.
    """
    path = folder / HOLDERS
    with reasoned(InputError, f"{path}: expected the list that 'skin keys new' makes"):
        content = path.read_bytes()
    try:
        return msgspec.json.decode(content, type=Holders)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: expected the list that 'skin keys new' makes: {error}") from error
