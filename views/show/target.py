"""What a user may show a skin in: a program that runs, or a new file."""

import re
from pathlib import Path
from typing import Final, NamedTuple

from canskin.errors import InputError
from canskin.session import HIGHEST_PORT
from shell.output import check_new_path
from shell.skin_options import check_host

LOOPBACK: Final = "127.0.0.1"
#: Foxglove's own default, 8765, is that of ``skin view``.
FOXGLOVE_PORT: Final = 8766
#: What Rerun's viewer listens to.
RERUN_URL: Final = re.compile(r"rerun(\+https?)?://[^/]+/proxy")
#: ``HOST:PORT``, ``:PORT`` or ``PORT``; addresses of IPv6 are in brackets.
_ADDRESS: Final = re.compile(r"(?:(?P<host>\[[0-9A-Fa-f:.]+\]|[^\[\]:/\\]*):)?(?P<port>[0-9]+)", re.ASCII)


class Address(NamedTuple):
    """Host and port; the host has brackets if it is an address of IPv6."""

    host: str
    port: int


def rerun_target(text: str) -> str | Path | None:
    """Return the URL of a running viewer, a new file (.rrd), or None: start a viewer."""
    if not text:
        return None
    if "://" in text:
        if not RERUN_URL.fullmatch(text):
            raise InputError(f"{text}: expected a viewer such as rerun+http://{LOOPBACK}:9876/proxy")
        return text
    found = _address_or_file(text, ".rrd")
    return f"rerun+http://{found.host}:{found.port}/proxy" if isinstance(found, Address) else found


def foxglove_target(text: str, *, insecure: bool = False) -> Address | Path:
    """Return the address of the server that the app connects to, or a new file (.mcap).

    Only with `insecure` the address may be of a network.
    """
    if not text:
        return Address(LOOPBACK, FOXGLOVE_PORT)
    if "://" in text:
        raise InputError(f"{text}: expected the HOST:PORT of a server, such as {LOOPBACK}:{FOXGLOVE_PORT}")
    found = _address_or_file(text, ".mcap")
    if isinstance(found, Address):
        check_host(text, found.host.strip("[]"), "see the skin", insecure=insecure)
    return found


def _address_or_file(text: str, suffix: str) -> Address | Path:
    address = _ADDRESS.fullmatch(text)
    if address:
        if int(address["port"]) > HIGHEST_PORT:
            raise InputError(f"{text}: expected a port of 0 to {HIGHEST_PORT}")
        return Address(address["host"] or LOOPBACK, int(address["port"]))
    path = Path(text)
    if path.suffix.lower() != suffix:
        raise InputError(f"{text}: expected HOST:PORT, or a new file that ends in {suffix}")
    check_new_path(path, "view")
    return path
