"""What zenoh's router lets each holder of keys do: its ``access_control``, made from the table of roles.

Each rule is bound to the common name of a certificate, and to links with certificates. A rule that answers lets a
program declare itself and reply; one that asks lets the answer out again; so for each action.
"""

from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from canskin.errors import InputError
from canskin.keys import HUB, PROTOCOLS_WITH_KEYS, parts_of
from canskin.peers import EVERY_KEY
from canskin.roles import ROLES
from hub.holders import read_holders

_TO_HUB: Final = "ingress"
_FROM_HUB: Final = "egress"
_REVOKED: Final = "revoked"
_MESSAGES: Final = (
    *("put", "declare_subscriber", "query", "declare_queryable", "reply"),
    *("liveliness_token", "liveliness_query", "declare_liveliness_subscriber"),
)


def access_control(folder: Path) -> dict[str, Any]:
    """Return the rules for the holders of a list, each with the keys of its own skin.

    A holder that is revoked connects, and may do nothing. So may one that the list does not have.

    Parameters
    ----------
    folder : pathlib.Path
        Of the hub's keys, which has a copy of the authority's list.

    Raises
    ------
    InputError
        If there is no list, or it has nobody.
    """
    holders = read_holders(folder)
    names: defaultdict[str, list[str]] = defaultdict(list)
    for common_name in holders.until:
        skin, role, _ = parts_of(common_name)
        if role in ROLES or role == HUB:
            names[_REVOKED if common_name in holders.revoked else f"{skin}:{role}"].append(common_name)
    if all(group.endswith(f":{HUB}") for group in names):
        raise InputError(f"{folder}: the list has no holder of keys: 'skin keys add'")
    rules, policies = [], []
    for group in names:
        # A denial of a rule tells whom it denies, that of the default does not.
        grants = [(_TO_HUB, ["put"], ["canskin/**"])] if group == _REVOKED else _grants(*group.split(":"))
        ids = []
        for number, (flow, messages, keys) in enumerate(grants):
            if keys:
                ids.append(f"{group}:{number}")
                rule = {"id": ids[-1], "flows": [flow], "messages": messages, "key_exprs": keys}
                rules.append(rule | {"permission": "deny" if group == _REVOKED else "allow"})
        policies.append({"rules": ids, "subjects": [group]})
    links = list(PROTOCOLS_WITH_KEYS)
    subjects = [{"id": each, "cert_common_names": named, "link_protocols": links} for each, named in names.items()]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _grants(skin: str, role: str) -> Iterator[tuple[str, list[str], list[str]]]:
    """Yield direction, kinds of messages and keys of all that a role needs."""
    if role == HUB:  # another hub passes what its own rules allow
        yield from ((flow, list(_MESSAGES), ["canskin/**"]) for flow in (_TO_HUB, _FROM_HUB))
        return
    allowed = ROLES[role]
    put, subscribe, ask, answer = (
        [f"canskin/{skin}/{name}" for name in names]
        for names in (allowed.names("put"), allowed.names("subscribe"), allowed.names("ask"), allowed.names("answer"))
    )
    yield _TO_HUB, ["put"], put
    yield _TO_HUB, ["declare_subscriber"], subscribe
    yield _TO_HUB, ["query"], ask
    yield _TO_HUB, ["declare_queryable", "reply"], answer
    yield _TO_HUB, ["liveliness_token"], [f"canskin/{skin}/alive/{service}/*" for service in allowed.appear]
    yield _TO_HUB, ["liveliness_query", "declare_liveliness_subscriber"], [EVERY_KEY]
    yield _FROM_HUB, ["put"], subscribe
    yield _FROM_HUB, ["declare_subscriber"], put  # tells a publisher that somebody listens
    yield _FROM_HUB, ["query"], answer
    yield _FROM_HUB, ["reply", "declare_queryable"], ask
    yield _FROM_HUB, ["liveliness_token"], [EVERY_KEY]
