"""One builder for each message of the services, and a fabric that keeps messages.

The client's tests use them on Python 3.10, without the application.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import replace

from canskin.fabric import Mailbox
from canskin.messages import (
    BlockState,
    BusState,
    Contact,
    Contacts,
    CycleMeasurement,
    FrameCounts,
    GatewayStatus,
    Image,
    Label,
    NodesStatus,
    ServiceStatus,
    SteppedMeasurement,
    Truth,
)

if TYPE_CHECKING:
    from skin.layout import Layout


class Published:
    """A fabric without wires: what a service publishes, and the mailboxes that the service asks for."""

    def __init__(self) -> None:
        self.messages: list[Any] = []
        self.mailboxes: list[Mailbox[Any]] = []

    def tell_scheduling(self, _scheduling: str) -> None:
        """Nobody listens."""

    def publish(self, _topic: object, message: Any) -> None:
        self.messages.append(message)

    def mailbox(self, _topic: object, depth: int = 4) -> Mailbox[Any]:
        self.mailboxes.append(Mailbox(depth))
        return self.mailboxes[-1]

    def of(self, kind: type) -> list[Any]:
        """Return the messages of a kind."""
        return [each for each in self.messages if isinstance(each, kind)]


def counter_of(cycle: int) -> int:
    """Return the counter of the SYNC of a cycle."""
    return (cycle - 1) % 240 + 1


def measurement(cycle: int = 1, **changed: Any) -> CycleMeasurement:
    """Return the sums of a cycle: of none, unless `changed` has some."""
    made = CycleMeasurement(
        cycle=cycle, sync_counter=counter_of(cycle), sampled_mono_ns=0, sums=b"", valid=b"", fingerprint=""
    )
    return replace(made, **changed)


def stepped_measurement(
    force_n: np.ndarray, known: np.ndarray | None = None, *, layout: Layout, **changed: Any
) -> SteppedMeasurement:
    """Return what the gateway would publish of these forces; `known`: bool, (blocks, block size)."""
    phi = layout.phi()
    counts = np.rint(force_n.reshape(-1) / layout.taxels.newton_per_count).astype(np.int32)
    known = np.ones(phi.kept.shape, np.bool_) if known is None else known
    sums = np.asarray(phi.forward(counts)).reshape(known.shape) * known
    valid = known.all(axis=1)
    states = np.where(valid, BlockState.FRESH, np.where(known.any(axis=1), BlockState.STALE, BlockState.DEAD))
    made = SteppedMeasurement(
        cycle=1,
        sync_counter=1,
        sampled_mono_ns=1_000_000,
        fingerprint=phi.fingerprint,
        noise_n=1e-3,
        sums=sums.astype("<i4").tobytes(),
        valid=valid.astype(np.uint8).tobytes(),
        known=known.astype(np.uint8).tobytes(),
        states=states.astype(np.uint8).tobytes(),
        since_ns=np.zeros(phi.blocks, "<i8").tobytes(),
    )
    return replace(made, **changed)


def image(cycle: int = 1, **changed: Any) -> Image:
    """Return the image of a cycle, without pixels unless `changed` has some."""
    made = Image(
        cycle=cycle,
        sync_counter=counter_of(cycle),
        sampled_mono_ns=0,
        published_mono_ns=1,
        pixels=b"",
        valid=b"",
        valid_sums=1,
        solve_s=0.0,
    )
    return replace(made, **changed)


def contact(**changed: Any) -> Contact:
    """Return a contact of four taxels around (0.5, 1.5)."""
    made = Contact(
        identity=1,
        row=0.5,
        column=1.5,
        force_n=0.5,
        peak_n=0.2,
        taxels=4,
        top=0,
        bottom=1,
        left=1,
        right=2,
        onset_mono_ns=5,
    )
    return replace(made, **changed)


def contacts(cycle: int = 1, *found: Contact, **changed: Any) -> Contacts:
    """Return the contacts `found` in the image of a cycle."""
    made = Contacts(
        cycle=cycle, sync_counter=counter_of(cycle), sampled_mono_ns=0, contacts=list(found), ended=[], find_s=0.0
    )
    return replace(made, **changed)


def label(cycle: int = 1, label: str = "cup", **changed: Any) -> Label:
    """Return the label of a cycle."""
    made = Label(
        cycle=cycle, sync_counter=counter_of(cycle), sampled_mono_ns=0, label=label, confidence=1.0, valid_sums=1
    )
    return replace(made, **changed)


def truth(step: int = 1, **changed: Any) -> Truth:
    """Return the truth of a step, without forces unless `changed` has some."""
    made = Truth(step=step, sync_counter=counter_of(step), sampled_mono_ns=0, true=b"", sensor=b"", label="")
    return replace(made, **changed)


def bus_state(name: str = "bus0", **changed: Any) -> BusState:
    """Return the state of a bus without nodes."""
    return replace(BusState(name=name, load_ratio=0.1, nodes=[], nmt=b""), **changed)


def gateway_status(cycles: int = 1, **changed: Any) -> GatewayStatus:
    """Return a status of complete cycles, without buses."""
    made = GatewayStatus(
        time_ns=0, cycles=cycles, cycles_complete=cycles, frames=FrameCounts(), sync_rate_hz=100.0, buses=[]
    )
    return replace(made, **changed)


def nodes_status(process: str = "nodes", **changed: Any) -> NodesStatus:
    """Return the counters of a process that has lost no frame."""
    return replace(NodesStatus(time_ns=0, process=process, frames_sent=0, frames_dropped=0, syncs_seen=10), **changed)


def service_status(second: int, service: str = "reconstructor", instance: str = "1", **changed: Any) -> ServiceStatus:
    """Return what a service tells of itself in a second of its life: 100 things made, half of the time at work."""
    made = ServiceStatus(
        time_ns=second * 1_000_000_000,
        service=service,
        instance=instance,
        memory_bytes=1 << 20,
        processor_s=0.5 * second,
        made=100 * second,
    )
    return replace(made, **changed)
