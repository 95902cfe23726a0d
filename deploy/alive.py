#!/usr/bin/env python3
"""Health check: ``skin-alive SERVICE ENDPOINT`` ends with 0 when a service of the default skin is on the fabric."""

import sys
import threading
from typing import Final

from skin.errors import SkinError
from skin.fabric import Fabric
from skin.layout import load_layout
from skin.service import say

PATIENCE_S: Final = 3.0


def is_alive(service: str, endpoint: str) -> bool:
    """Tell whether `service` announces itself on the fabric whose hub is at `endpoint`."""
    found = threading.Event()

    def changed(name: str, alive: bool) -> None:
        if alive and name == service:
            found.set()

    fabric = Fabric(load_layout().name, "health", endpoint)
    try:
        fabric.watch(changed)
        return found.wait(PATIENCE_S)
    finally:
        fabric.close()


def main() -> int:
    """Run the check; 1 is a service that is not there, 2 a wrong call."""
    if len(sys.argv) != 3:
        say("skin-alive", "expected SERVICE ENDPOINT, for example: nodes tcp/127.0.0.1:7447")
        return 2
    try:
        return 0 if is_alive(*sys.argv[1:]) else 1
    except SkinError as error:
        say("skin-alive", str(error))
        return 1


if __name__ == "__main__":
    sys.exit(main())
