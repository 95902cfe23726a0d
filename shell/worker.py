"""A worker: one service of every skin of the hub in one process, so that kernels and imports are there once."""

import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

from canskin.errors import SkinError
from canskin.fabric import Fabric, Shared
from canskin.keys import environment_keys
from canskin.peers import Peer
from canskin.session import checked
from shell.pulse import Pulse
from shell.service import LOOK_S, ServiceThread, StopSignal, say
from shell.skin_options import SkinOptions, await_skins, knows_layout
from shell.watchdog import WATCHDOG

#: A skin whose gateway has been away for this time is served no more, until its gateway returns.
GONE_S: Final = 60.0
#: Serves one skin until its stop signal; told whether the hub has no other skin.
Serve = Callable[[SkinOptions, bool], None]


def serve_skins(service: str, of: SkinOptions, serve: Serve) -> None:
    """Serve the skin that options or keys name, or in ``skin run`` the only one; else every skin, in threads.

    Parameters
    ----------
    service : str
        Its name.

    Raises
    ------
    BusError
        If no skin comes in `shell.skin_options.SERVICE_PATIENCE_S`.
    SkinError
        If no skin of the hub can be served: why not the first.
    """
    keys = checked(of.endpoint, environment_keys())[1]
    if of.layout or of.skin or keys or isinstance(threading.current_thread(), ServiceThread):
        serve(of, True)
        return
    stop = StopSignal().install()
    pulse, worker = Pulse(stop), _Worker(service, of, serve)
    await_skins(of.endpoint, service, stop)
    Fabric.shared, WATCHDOG.joins = Shared(), True
    try:
        with closing(Fabric("", "", of.endpoint, stop=stop)) as fabric:
            fabric.watch_peers(worker.note)
            while not pulse.is_set():
                worker.look(time.monotonic())
                time.sleep(LOOK_S)
    finally:
        worker.stop()
        Fabric.shared, WATCHDOG.joins = None, False
        WATCHDOG.services.clear()


@dataclass
class _Served:
    """A skin with its thread, its gateway at the start, and when a gateway was last there."""

    thread: ServiceThread
    gateway: Peer
    seen_s: float
    is_left_out: bool = False


class _Worker:
    """Has a thread for each skin whose gateway is there."""

    def __init__(self, service: str, of: SkinOptions, serve: Serve) -> None:
        self._service, self._of, self._serve = service, of, serve
        self._gateways: dict[str, Peer] = {}
        self._skins: dict[str, _Served] = {}

    def note(self, peer: Peer, is_there: bool) -> None:
        """Note that a service came or went; in a thread of the fabric."""
        if not knows_layout(peer):
            return
        if is_there:
            self._gateways[peer.skin] = peer
        elif self._gateways.get(peer.skin) == peer:  # no other gateway has come before
            del self._gateways[peer.skin]

    def look(self, now_s: float) -> None:
        """Begin with skins that have come, anew with those of another Φ, and end those that are gone."""
        gateways = self._gateways.copy()
        for skin, gateway in gateways.items():
            served = self._skins.get(skin)
            if served is None:
                self._start(skin, gateway, now_s, is_only=len(gateways) == 1)
                continue
            served.seen_s = now_s
            is_new = served.is_left_out and served.gateway.instance != gateway.instance
            if is_new or served.gateway.fingerprint != gateway.fingerprint:
                self._end(skin)  # and starts at the next look
        for skin, served in [*self._skins.items()]:
            if now_s - served.seen_s > GONE_S:
                say(self._service, f"skin '{skin}' is gone")
                self._end(skin)
        self._look_for_errors()

    def stop(self) -> None:
        """End all threads."""
        for served in self._skins.values():
            served.thread.stop.set()
        for skin in [*self._skins]:
            self._end(skin)

    def _start(self, skin: str, gateway: Peer, now_s: float, *, is_only: bool) -> None:
        say(self._service, f"serves skin '{skin}'")
        serve = partial(self._serve, replace(self._of, skin=skin), is_only)
        thread = ServiceThread(f"{self._service} of {skin}", serve, lambda: None)
        self._skins[skin] = _Served(thread, gateway, now_s)
        thread.start()

    def _end(self, skin: str) -> None:
        thread = self._skins[skin].thread
        thread.stop.set()
        thread.join()
        WATCHDOG.services.discard(thread.name)
        del self._skins[skin]

    def _look_for_errors(self) -> None:
        """Leave out skins that cannot be served; raise why not, if there is no other."""
        errors = {skin: served.thread.error for skin, served in self._skins.items() if served.thread.error is not None}
        for skin, error in errors.items():
            served = self._skins[skin]
            if not isinstance(error, SkinError) or len(errors) == len(self._skins):
                raise error
            if not served.is_left_out:
                served.is_left_out = True
                WATCHDOG.services.discard(served.thread.name)
                say(self._service, f"skin '{skin}' is left out: {error}")
