"""Health check: ``skin-alive SERVICE [ENDPOINT [SKIN]]`` ends with 0 if a service is on the fabric and does its work.

The gateway and the nodes work if blocks are measured, the reconstructor if images of measured blocks come, the
classifier if labels of measured blocks come. Of any other service its presence is enough. SKIN is the name of a layout.
Without SKIN a service of any skin counts, because the image does not know its layout.
"""

import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack, closing
from typing import Any, Final

from canskin.errors import SkinError
from canskin.fabric import Fabric
from canskin.messages import (
    IMAGE,
    LABEL,
    MEASUREMENT,
    Image,
    Label,
    Measurement,
    Topic,
)
from canskin.peers import Peer
from canskin.session import DEFAULT_ENDPOINT, peers_at
from health.causes import Cause
from shell.service import say

#: Longest wait for the hub and the service.
PATIENCE_S: Final = 3.0
#: Longest wait for a message that shows its work.
WORK_S: Final = 3.0


def _has_blocks(message: Measurement | Image) -> bool:
    return any(message.valid)


def _sees(label: Label) -> bool:
    return not label.blind and label.valid_sums > 0


#: The topic of a service's work, and which of its messages show the work.
WORK: Final[dict[str, tuple[Topic, Callable[[Any], bool]]]] = {
    "nodes": (MEASUREMENT, _has_blocks),
    "gateway": (MEASUREMENT, _has_blocks),
    "reconstructor": (IMAGE, _has_blocks),
    "classifier": (LABEL, _sees),
}


def trouble(service: str, endpoint: str = DEFAULT_ENDPOINT, skin: str | None = None) -> str:
    """Return why `service`, with the hub at `endpoint`, is not healthy; empty if it is.

    Raises
    ------
    BusError
        If the endpoint cannot be used, or no hub answers in time.
    """

    def those_of(peers: list[Peer]) -> set[str]:
        return {peer.skin for peer in peers if peer.service == service and skin in {None, peer.skin}}

    skins = those_of(peers_at(endpoint, PATIENCE_S, lambda peers: bool(those_of(peers))))
    if not skins:
        return f"{service} is not there [{Cause.SERVICE_ABSENT.code}]"
    if service not in WORK or _works(service, endpoint, skins):
        return ""
    return f"{service} is there, but nothing tells of measured blocks [{Cause.SERVICE_SILENT.code}]"


def _works(service: str, endpoint: str, skins: set[str]) -> bool:
    """Tell whether a message shows the work of a service of one of `skins`."""
    shown = threading.Event()
    topic, is_work = WORK[service]

    def take(message: Any) -> None:
        if is_work(message):
            shown.set()

    with ExitStack() as stack:
        for skin in skins:
            # Without a name: the other services do not see this program come and go.
            fabric = stack.enter_context(closing(Fabric(skin, "", endpoint, patience_s=PATIENCE_S)))
            fabric.subscribe(topic, take)
        return shown.wait(WORK_S)


def main() -> int:
    """Run the check; exit code 1: the service is absent or does not work, 2: wrong call."""
    if len(sys.argv) not in {2, 3, 4}:
        say("skin-alive", "expected SERVICE [ENDPOINT [SKIN]], for example: nodes tcp/127.0.0.1:7447")
        return 2
    try:
        text = trouble(*sys.argv[1:])
    except SkinError as error:
        text = str(error)
    if text:
        say("skin-alive", text)
    return 1 if text else 0
