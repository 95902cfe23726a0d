"""``skin keys``: who may connect to the hub of a robot."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

from cyclopts import Parameter

from canskin.errors import InputError
from canskin.keys import HUB, parts_of
from canskin.roles import ACTIONS, ROLES
from hub.authority import Authority, new_authority
from hub.holders import read_holders
from shell.terminal import print_table

_SKIN: Final = "[a-z][a-z0-9_]*"
#: A common name; 64 characters are the most (RFC 5280, upper bound of X520CommonName).
_NAME: Final = re.compile(rf"(?=.{{1,64}}$){_SKIN}:({'|'.join((HUB, *ROLES))})(:[A-Za-z0-9_-]+)?")
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
    if not re.fullmatch(_SKIN, skin):
        raise InputError(f"--skin {skin}: expected the name of the skin in its layout: small letters, digits and _")
    if skin in {HUB, *ROLES}:
        raise InputError(f"--skin {skin}: a role has that name: give the skin another one in its layout")
    names = _common_names(skin, (HUB, *ROLES))
    _issue(new_authority(folder, skin, host), names)


def add(folder: Path, *names: str) -> None:
    """Make keys of new holders, so that each can be revoked alone.

    Parameters
    ----------
    folder
        Folder of ``skin keys new``.
    names
        ROLE, ROLE:HOLDER, or SKIN:ROLE and SKIN:ROLE:HOLDER for another skin on the same hub.

    Examples
    --------
    skin keys add keys client:laptop7 operator:anna
    skin keys add keys hand:gateway hand:reconstructor
    """
    authority = Authority(folder)
    wanted = _common_names(authority.list.skin, names)
    for name in wanted:
        if parts_of(name)[1] == HUB:
            raise InputError(f"'{name}': the hub has keys: 'skin keys renew {folder} hub'")
        if name in authority.list.until:
            raise InputError(f"'{name}' has keys: 'skin keys renew', or add another holder")
    _issue(authority, wanted)
    _advise(folder)


def renew(folder: Path, *names: str, host: Hosts = ()) -> None:
    """Make new keys and certificates for another year; those before count until they end.

    Renewing stops no copy of keys: ``skin keys revoke`` does. A program reads its new files when it connects again; the
    hub must be started again.

    Parameters
    ----------
    folder
        Folder of ``skin keys new``.
    names
        See ``skin keys add``; default: all that are not revoked.
    host
        Names and addresses of the hub's machine, in place of those before.

    Examples
    --------
    skin keys renew keys client:laptop7
    skin keys renew keys hub --host robot.local 10.0.0.6
    """
    authority = Authority(folder)
    authority.list.hosts = list(host) or authority.list.hosts
    wanted = _known(authority, names or authority.list.allowed)
    _issue(authority, wanted)
    if any(parts_of(name)[1] == HUB for name in wanted):
        _advise(folder)


def revoke(folder: Path, *names: str) -> None:
    """Let keys count no longer: lost or stolen ones. Those of the hub need a new authority.

    Parameters
    ----------
    folder
        Folder of ``skin keys new``.
    names
        See ``skin keys add``.

    Examples
    --------
    skin keys revoke keys client:laptop7
    skin keys revoke keys viewer operator:anna
    """
    authority = Authority(folder)
    wanted = _known(authority, names)
    if any(parts_of(name)[1] == HUB for name in wanted):
        raise InputError(
            "the hub's keys cannot be revoked: no program asks a list; make a new authority: 'skin keys new'"
        )
    authority.list.revoked = sorted({*authority.list.revoked, *wanted})
    authority.write_list()
    _advise(folder)


def list_(folder: Path) -> None:
    """List the holders of keys: who, in which role, until when.

    Parameters
    ----------
    folder
        Folder of ``skin keys new``, or of the hub's keys.

    Examples
    --------
    skin keys list keys
    skin keys list /etc/canskin/keys/hub
    """
    holders = read_holders(folder)
    rows = ((*parts_of(name), "revoked" if name in holders.revoked else until) for name, until in holders.until.items())
    print_table(["skin", "role", "holder", "until"], rows)


def explain(role: str | None = None) -> None:
    """Print who may do what on the fabric, and why: the table from which the hub's rules are made.

    Parameters
    ----------
    role
        Default: all roles.

    Examples
    --------
    skin keys explain
    skin keys explain viewer
    """
    if role not in {None, *ROLES}:
        raise InputError(f"role '{role}': expected one of {', '.join(ROLES)}")
    for name, each in ROLES.items():
        if role in {None, name}:
            print(f"{name}: {each.why}")
            print_table(
                (), [(f"  {action}", ", ".join(each.names(action))) for action in ACTIONS if each.names(action)]
            )


def _common_names(skin: str, names: Sequence[str]) -> list[str]:
    """Return checked common names; `skin` is meant where none is named."""
    if not names:
        raise InputError("expected ROLE or ROLE:HOLDER, got none: see 'skin keys list'")
    found = [name if name.split(":")[0] not in {HUB, *ROLES} else f"{skin}:{name}" for name in dict.fromkeys(names)]
    for name in found:
        if not _NAME.fullmatch(name):
            roles = ", ".join((HUB, *ROLES))
            raise InputError(
                f"'{name}': expected ROLE, ROLE:HOLDER or SKIN:ROLE:HOLDER, 64 signs at most, ROLE one of {roles}"
            )
    return found


def _known(authority: Authority, names: Sequence[str]) -> list[str]:
    wanted = _common_names(authority.list.skin, names)
    for name in wanted:
        if name not in authority.list.until:
            raise InputError(f"'{name}' has no keys: see 'skin keys list'")
    return wanted


def _advise(folder: Path) -> None:
    print(f"now copy {folder / HUB} to the hub's machine, and start the hub again")


def _issue(authority: Authority, names: Sequence[str]) -> None:
    """Issue certificates, and print their folders."""
    for name in names:
        print(authority.issue(name))
