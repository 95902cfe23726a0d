"""``skin run``: services of a skin in one process."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import groupby
from pathlib import Path
from queue import SimpleQueue
from typing import Annotated, Any, Final

from cyclopts import Parameter

from canskin.errors import InputError
from canskin.fabric import Fabric, Shared
from shell.command import build_app
from shell.service import LOOK_S, ServiceThread, StopSignal
from shell.watchdog import WATCHDOG

#: In the order of the data, in which they are stopped.
SERVICES: Final = ("gateway", "reconstruct", "classify", "view")
#: Those between a touch and an image. With the others SYNC waits for their share of the interpreter's lock.
DEFAULT: Final = "gateway + reconstruct"
#: Between the words of two services.
AND: Final = "+"


def run(
    *words: Annotated[str, Parameter(allow_leading_hyphen=True)],
    layout: Path | None = None,
    listen: str | None = None,
    connect: str | None = None,
) -> None:
    """Run services of a skin in one process: they pass measurements and images without encoding them.

    Each has a thread. The end of one, by an error or not, is the end of the process.

    Parameters
    ----------
    words
        The services, ``+`` between two, each with options of its own; by default gateway + reconstruct. With
        classify or view beside a gateway SYNC is later.
    layout
        TOML of the skin; without it the default skin, or without a gateway the layout that the hub tells.
    listen
        Endpoint of the fabric's hub, which the gateway runs.
    connect
        Endpoint of another hub; the gateway then runs none.

    Examples
    --------
    skin run
    skin run --layout palm.toml gateway -i socketcan -c can0 + reconstruct --gains gains.json
    skin run classify + view --port 0
    """
    serve = _parsed(words or DEFAULT.split(), layout, listen, connect)
    has_hub = "gateway" in serve and connect is None
    if listen is not None and not has_hub:
        raise InputError("--listen: expected a gateway among the services, and no --connect")
    ended: SimpleQueue[None] = SimpleQueue()  # unlike an event or a queue, a signal may set it at any time
    services = [ServiceThread(verb, serve[verb], partial(ended.put, None)) for verb in SERVICES if verb in serve]
    WATCHDOG.services, shared = set(serve), Shared()
    Fabric.shared = shared
    StopSignal().install(partial(ended.put, None))
    try:
        for service in services:
            if ended.empty():
                service.start()
            while has_hub and shared.session is None and ended.empty():
                time.sleep(LOOK_S)  # the others use the session of the hub
        ended.get()
    finally:
        for service in filter(ServiceThread.is_alive, services):
            service.stop.set()
            service.join()
        WATCHDOG.services, Fabric.shared = set(), None
    for service in services:
        if service.error is not None:
            raise service.error


def _parsed(
    words: Sequence[str], layout: Path | None, listen: str | None, connect: str | None
) -> dict[str, Callable[[], Any]]:
    """Return what runs each service, by its verb.

    Raises
    ------
    InputError
        If the words name no verb, another verb, or one twice.
    cyclopts.CycloptsError
        If a verb does not take its words.
    """
    app, serve = build_app(), dict[str, Callable[[], Any]]()
    for verb, *options in [[*part] for is_end, part in groupby(words, AND.__eq__) if not is_end] or [[AND]]:
        if verb not in SERVICES or verb in serve:
            raise InputError(f"expected each of {', '.join(SERVICES)} once, '{AND}' between two, got '{verb}'")
        hub = {"--listen": listen, "--connect": connect} if verb == "gateway" else {"--connect": connect or listen}
        common = {"--layout": layout, **hub}
        options += [word for name, value in common.items() if value is not None for word in (name, str(value))]
        command, bound, _ = app.parse_args([verb, *options])
        serve[verb] = partial(command, *bound.args, **bound.kwargs)
    return serve
