"""Folders of keys for tests: those of an authority, and certificates of other days."""

from datetime import timedelta
from pathlib import Path
from unittest import mock

from hub.authority import Authority, new_authority


def make_authority(folder: Path, *names: str, skin: str = "palm") -> Authority:
    """Return a new authority that has issued keys of the hub and of `names`, ``ROLE`` or ``ROLE:HOLDER``."""
    authority = new_authority(folder, skin, ())
    for name in ("hub", *names):
        authority.issue(f"{skin}:{name}")
    return authority


def issue_for(authority: Authority, name: str, lasts_s: float, begins_s: float = -3600.0) -> Path:
    """Return new keys of `name` that count from `begins_s` to `lasts_s`, both from now on."""
    with (
        mock.patch("hub.authority.HOLDER_DAYS", lasts_s / 86400),
        mock.patch("hub.authority.SLOW_CLOCK", timedelta(seconds=-begins_s)),
    ):
        return authority.issue(f"{authority.list.skin}:{name}")
