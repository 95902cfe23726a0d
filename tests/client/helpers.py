"""A skin of 4 x 4 taxels, its messages, and stand-ins for its services. They use nothing of the application."""

import threading

import msgspec
import numpy as np

from canskin.calibration_messages import CALIBRATION, CalibrationReply, CalibrationRequest, Region
from canskin.description import DESCRIPTION, Description, DescriptionRequest
from canskin.fabric import Fabric, Reply
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, MEASUREMENT, Contacts, Image, Label, Measurement
from canskin.peers import Peer
from tests import messages as make
from tests.processes import PATIENCE_S

ROWS, COLUMNS, BLOCKS = 4, 4, 2


def description(boot_id: str = "") -> Description:
    """Return a skin of 4 x 4 taxels in two blocks: block 0 has the even taxels; each block sends rows 0 and 3."""
    order = np.r_[np.arange(0, 16, 2), np.arange(1, 16, 2)]
    kept = np.zeros((BLOCKS, 8), np.uint8)
    kept[:, [0, 3]] = 1
    return Description(
        name="palm",
        rows=ROWS,
        columns=COLUMNS,
        pitch_m=0.004,
        blocks=BLOCKS,
        sums=4,
        order=order.astype("<u4").tobytes(),
        kept=kept.tobytes(),
        newton_per_count=0.001,
        force_max_n=1.0,
        rate_hz=100.0,
        sending="synchronous",
        fingerprint="0123456789abcdef",
        boot_id=boot_id,
    )


def measurement(cycle: int, valid: bytes = bytes((1, 1)), **changed: object) -> Measurement:
    about: dict[str, object] = {
        "sampled_mono_ns": at_ns(cycle),
        "sampled_error_ns": 2000,
        "wall_offset_ns": 7_000_000_000,
        "sums": np.array((10, 20, 30, 40), "<i4").tobytes(),
        "valid": valid,
        "fingerprint": "0123456789abcdef",
    }
    return make.measurement(cycle, **about | changed)


def image(cycle: int, valid: bytes = bytes((1, 1))) -> Image:
    return make.image(
        cycle,
        sampled_mono_ns=at_ns(cycle),
        sampled_error_ns=2000,
        published_mono_ns=at_ns(cycle) + 1,
        pixels=np.arange(16, dtype="<f4").tobytes(),
        valid=valid,
        valid_sums=4,
        solve_s=0.001,
    )


def contacts(cycle: int, force_n: float = 0.5, *, blind: bool = False) -> Contacts:
    touch = make.contact(row=1.0, column=2.0, position_m=(0.002, -0.004, 0.0), force_n=force_n)
    return make.contacts(cycle, *[touch] * (not blind), sampled_mono_ns=at_ns(cycle), blind=blind)


def label(cycle: int, name: str = "cup", *, blind: bool = False) -> Label:
    return make.label(cycle, name, sampled_mono_ns=at_ns(cycle), confidence=0.9, valid_sums=4, blind=blind)


def at_ns(cycle: int) -> int:
    """Return the sampling instant of a cycle: one each 10 ms."""
    return 10_000_000 * cycle


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
            self.gateway.publish(GATEWAY, make.gateway_status(cycle))
            self.gateway.publish(MEASUREMENT, measurement(cycle, fingerprint=self.fingerprint))
            self.gateway.publish(LABEL, label(cycle))
            self.gateway.publish(IMAGE, image(cycle))
            self.gateway.publish(CONTACTS, contacts(cycle))

    def close(self) -> None:
        self._stop.set()
        if self._sending is not None:
            self._sending.join()
        self.gateway.close()


def await_peers(hub: Fabric, *names: str) -> None:
    """Wait until services, each as SKIN/SERVICE, are on a hub, which hears of them a little after their start."""
    there, changed = set[str](), threading.Condition()

    def note(peer: Peer, alive: bool) -> None:
        with changed:
            (there.add if alive else there.discard)(f"{peer.skin}/{peer.service}")
            changed.notify()

    hub.watch_peers(note)
    with changed:
        assert changed.wait_for(lambda: there >= set(names), PATIENCE_S), there
