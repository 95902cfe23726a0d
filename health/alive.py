"""Health check: ``skin-alive SERVICE ENDPOINT [SKIN]`` ends with 0 if a service is on the fabric.

SKIN is the name of a layout. Without SKIN a service of any skin counts, because the image does not know its layout.
"""

import sys
from typing import Final

from canskin.errors import SkinError
from canskin.peers import Peer
from canskin.session import peers_at
from shell.service import say

PATIENCE_S: Final = 3.0


def is_alive(service: str, endpoint: str, skin: str | None = None) -> bool:
    """Tell whether `service` is on the fabric with the hub at `endpoint`."""

    def is_among(peers: list[Peer]) -> bool:
        return any(peer.service == service and skin in {None, peer.skin} for peer in peers)

    return is_among(peers_at(endpoint, PATIENCE_S, is_among))


def main() -> int:
    """Run the check; exit code 1: the service is absent, 2: wrong call."""
    if len(sys.argv) not in {3, 4}:
        say("skin-alive", "expected SERVICE ENDPOINT [SKIN], for example: nodes tcp/127.0.0.1:7447")
        return 2
    try:
        return 0 if is_alive(*sys.argv[1:]) else 1
    except SkinError as error:
        say("skin-alive", str(error))
        return 1
