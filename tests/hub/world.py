"""A hub in a process of its own, with keys or without, a gateway, and another program that has a reader's keys."""

from pathlib import Path
from typing import Any

from canskin.calibration_messages import CALIBRATION, CalibrationReply, CalibrationRequest
from canskin.description import DESCRIPTION
from canskin.fabric import Fabric, Reply
from canskin.keys import Keys
from canskin.session import open_client
from skin.description import describe
from tests.hub.keys import make_authority
from tests.layouts import small_layout
from tests.processes import PATIENCE_S, Processes, free_port

ROLES = ("gateway", "reconstructor", "client", "client:stolen", "operator")


class World:
    """The hub is on `endpoint`; `attacker` is a session of the other program."""

    def __init__(self, folder: Path, *, has_keys: bool) -> None:
        self.folder, self.has_keys = folder, has_keys
        self.endpoint = f"{'tls' if has_keys else 'tcp'}/127.0.0.1:{free_port()}"
        self.processes = Processes(folder)
        if has_keys:
            make_authority(folder / "keys", *ROLES)
        keys = ("--keys", str(folder / "keys" / "hub")) if has_keys else ()
        self.processes.skin("hub", "hub", "--listen", self.endpoint, *keys)
        self.tared: list[CalibrationRequest] = []
        self.gateway = self.join("gateway", prepare=self._answer)
        self.attacker: Any = open_client(self.endpoint, "attacker", None, PATIENCE_S, keys=self.keys("client.stolen"))

    def keys(self, name: str) -> Keys | None:
        return Keys(self.folder / "keys" / name) if self.has_keys else None

    def join(self, service: str, role: str = "", **options: Any) -> Fabric:
        return Fabric("palm", service, self.endpoint, keys=self.keys(role or service), patience_s=PATIENCE_S, **options)

    def close(self) -> None:
        self.attacker.close()
        self.gateway.close()
        with self.processes:
            pass

    def _answer(self, fabric: Fabric) -> None:
        fabric.answer(CALIBRATION, self._tare)
        about = describe(small_layout())
        fabric.answer(DESCRIPTION, lambda _request, reply: reply(about))

    def _tare(self, request: CalibrationRequest, reply: Reply) -> None:
        self.tared.append(request)
        reply(CalibrationReply(is_done=True, text="of the gateway"))
