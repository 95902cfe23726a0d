"""``skin keys``: who may connect to the hub of a robot."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

import msgspec
from cyclopts import Parameter

from canskin.errors import InputError
from canskin.keys import HUB
from canskin.roles import ROLES
from hub.authority import Authority, new_authority
from hub.holders import read_holders
from shell.terminal import Json, print_json, print_table
from skin.layout_keys import Name

_HOLDER: Final = re.compile(r"[A-Za-z0-9_-]+")
Hosts = Annotated[tuple[str, ...], Parameter(name="--host")]


def new(folder: Path, *, skin: str, host: Hosts = ()) -> None:
    """Make the authority of a robot, the keys of its hub, and a folder of keys for each role.

    Keep the folder ``authority`` to yourself: whoever has it can make keys. Copy the folder of a role, and nothing
    else, to the machine whose program has the role.

    Parameters
    ----------
    folder
        New folder.
    skin
        Name of the skin, as its layout says.
    host
        Names and addresses of the hub's machine, by which other machines reach the hub.

    Examples
    --------
    skin keys new keys --skin palm
    skin keys new keys --skin palm --host robot.local 10.0.0.5
    """
    names = [_common_name(role, skin) for role in (HUB, *ROLES)]
    _issue(new_authority(folder, skin, host), names)


def add(folder: Path, *names: str, skin: str | None = None) -> None:
    """Make keys of new holders, so that each can be revoked alone.

    Parameters
    ----------
    folder
        Folder of ``skin keys new``.
    names
        ROLE or ROLE:HOLDER.
    skin
        Another skin on the same hub.

    Examples
    --------
    skin keys add keys client:laptop7 operator:anna
    skin keys add keys gateway reconstructor --skin hand
    """
    authority = Authority(folder)
    wanted = _named(authority, names, skin)
    for name in wanted:
        if name in authority.list.holders or authority.keys_of(name).exists():
            raise InputError(f"'{name}' has keys: 'skin keys renew', or add another holder")
    _issue(authority, wanted)


def renew(folder: Path, *names: str, skin: str | None = None, host: Hosts = ()) -> None:
    """Make new keys and certificates for another year; those before count until they end.

    A program reads its new files when it connects again; the hub must be started again.

    Parameters
    ----------
    folder
        Folder of ``skin keys new``.
    names
        ROLE or ROLE:HOLDER; default: all that are not revoked.
    skin
        Another skin on the same hub.
    host
        Names and addresses of the hub's machine, in place of those before.

    Examples
    --------
    skin keys renew keys client:laptop7
    skin keys renew keys hub --host robot.local 10.0.0.6
    """
    authority = Authority(folder)
    authority.list.hosts = list(host) or authority.list.hosts
    _issue(authority, _known(authority, names, skin) if names else authority.list.allowed)


def revoke(folder: Path, *names: str, skin: str | None = None) -> None:
    """Let keys count no longer: lost or stolen ones.

    Parameters
    ----------
    folder
        Folder of ``skin keys new``.
    names
        ROLE or ROLE:HOLDER.
    skin
        Another skin on the same hub.

    Examples
    --------
    skin keys revoke keys client:laptop7
    skin keys revoke keys viewer operator:anna
    """
    authority = Authority(folder)
    for name in _known(authority, names, skin):
        authority.list.holders[name].is_revoked = True
        print(f"{name} is revoked")
    authority.write_list()
    hub = authority.keys_of(f"{authority.list.skin}:{HUB}")
    print(f"now copy {hub} to the hub's machine, and start the hub again")


def list_(folder: Path, *, json: Json = False) -> None:
    """List the holders of keys: who, in which role, until when.

    Parameters
    ----------
    folder
        Folder of ``skin keys new``, or of the hub's keys.
    json
        Print one JSON object.

    Examples
    --------
    skin keys list keys
    skin keys list /etc/canskin/keys/hub --json
    """
    holders = read_holders(folder)
    if json:
        print_json(holders)
        return
    rows = (
        (*f"{name}:".split(":", 3)[:3], each.until, "revoked" * each.is_revoked)
        for name, each in holders.holders.items()
    )
    print_table(["skin", "role", "holder", "until", ""], rows)


def _common_name(name: str, skin: str) -> str:
    role, colon, holder = name.partition(":")
    if role not in {HUB, *ROLES} or (colon and not _HOLDER.fullmatch(holder)):
        raise InputError(f"'{name}': expected ROLE or ROLE:HOLDER, ROLE one of {', '.join((HUB, *ROLES))}")
    try:
        msgspec.convert(skin, Name)
    except msgspec.ValidationError as error:
        raise InputError(f"--skin {skin}: expected the name of a skin, as its layout says: {error}") from error
    return f"{skin}:{name}"


def _named(authority: Authority, names: Sequence[str], skin: str | None) -> list[str]:
    if not names:
        raise InputError("expected ROLE or ROLE:HOLDER, got none: see 'skin keys list'")
    return [_common_name(name, skin or authority.list.skin) for name in dict.fromkeys(names)]


def _known(authority: Authority, names: Sequence[str], skin: str | None) -> list[str]:
    wanted = _named(authority, names, skin)
    for name in wanted:
        if name not in authority.list.holders:
            raise InputError(f"'{name}' has no keys: see 'skin keys list'")
    return wanted


def _issue(authority: Authority, names: Sequence[str]) -> None:
    """Issue certificates, and print their folders."""
    for name in names:
        print(authority.issue(name, authority.list.hosts))
    authority.write_list()
