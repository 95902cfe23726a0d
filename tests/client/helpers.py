"""Stand-ins for the services of a skin."""

import threading

import msgspec

from canskin.calibration_messages import CALIBRATION, CalibrationReply, CalibrationRequest, Region
from canskin.description import DESCRIPTION, DescriptionRequest
from canskin.fabric import Fabric, Reply
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, MEASUREMENT
from tests.client.conftest import contacts, description, image, label, measurement
from tests.messages import gateway_status


class Chain:
    """A hub with a gateway and, if wanted, a reconstructor, which send what they are told."""

    def __init__(self, endpoint: str, skin: str = "palm") -> None:
        self.endpoint = endpoint
        self.gateway = Fabric(skin, "gateway", endpoint, hub=True)
        self.fingerprint = description().fingerprint
        self.gateway.answer(DESCRIPTION, self._describe)
        self.gateway.answer(CALIBRATION, self._calibrate)
        self._stop = threading.Event()
        self._sending: threading.Thread | None = None
        self.tares: list[bool | Region] = []

    def _describe(self, _request: DescriptionRequest, reply: Reply) -> None:
        reply(msgspec.structs.replace(description(), fingerprint=self.fingerprint))

    def _calibrate(self, request: CalibrationRequest, reply: Reply) -> None:
        self.tares.append(request.region or request.force)
        is_done = request.force or request.region is not None
        reply(CalibrationReply(is_done=is_done, text="zero measured" if is_done else "it is touched"))

    def start(self) -> None:
        """Send cycle after cycle until the end."""
        self._sending = threading.Thread(target=self._send)
        self._sending.start()

    def _send(self) -> None:
        cycle = 0
        while not self._stop.wait(0.005):
            cycle += 1
            self.gateway.publish(GATEWAY, gateway_status(cycle))
            self.gateway.publish(MEASUREMENT, measurement(cycle, fingerprint=self.fingerprint))
            self.gateway.publish(LABEL, label(cycle))
            self.gateway.publish(IMAGE, image(cycle))
            self.gateway.publish(CONTACTS, contacts(cycle))

    def close(self) -> None:
        self._stop.set()
        if self._sending is not None:
            self._sending.join()
        self.gateway.close()
