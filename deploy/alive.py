#!/usr/bin/env python3
"""Health check: ``skin-alive SERVICE ENDPOINT [SKIN]`` ends with 0 when a service is on the fabric.

Without SKIN, the name of a layout, a service of any skin counts: the image does not know which layout it is given.
"""

import sys
import threading
from typing import Final

from skin.errors import SkinError
from skin.fabric import Fabric
from skin.peers import Peer
from skin.service import say

PATIENCE_S: Final = 3.0
#: What the check calls itself, a skin's name included.
NAME: Final = "health"


def is_alive(service: str, endpoint: str, skin: str | None = None) -> bool:
    """Tell whether `service` announces itself on the fabric whose hub is at `endpoint`."""
    found = threading.Event()

    def changed(peer: Peer, alive: bool) -> None:
        if alive and peer.service == service and skin in {None, peer.skin}:
            found.set()

    fabric = Fabric(skin or NAME, NAME, endpoint, patience_s=PATIENCE_S)
    try:
        fabric.watch_peers(changed)
        return found.wait(PATIENCE_S)
    finally:
        fabric.close()


def main() -> int:
    """Run the check; 1 is a service that is not there, 2 a wrong call."""
    if len(sys.argv) not in {3, 4}:
        say("skin-alive", "expected SERVICE ENDPOINT [SKIN], for example: nodes tcp/127.0.0.1:7447")
        return 2
    try:
        return 0 if is_alive(*sys.argv[1:]) else 1
    except SkinError as error:
        say("skin-alive", str(error))
        return 1


if __name__ == "__main__":
    sys.exit(main())
