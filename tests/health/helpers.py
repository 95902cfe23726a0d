"""Messages of a small skin."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, cast

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.fabric import Fabric, Unread
from canskin.messages import (
    Contacts,
    FrameCounts,
    GatewayStatus,
    Image,
    Label,
    NodeEmergency,
    NodesStatus,
    Topic,
    Truth,
)
from canskin.peers import Peer
from health.state import ViewState
from skin.layout import Layout
from tests import messages as make
from tests.layouts import buses, small_layout

SECOND_NS = 1_000_000_000


def note(state: ViewState, name: str, alive: bool, now_s: float) -> None:
    """Let a service of the small skin come or go."""
    state.take_peer(Peer("palm", name, "1"), alive, now_s)


def seen_of(state: ViewState, now_s: float, **options: int) -> Any:
    """Return the snapshot of a time; what a test reads of it is there."""
    return state.snapshot(now_s, **options)[0]


def palm_layout(**tables: Any) -> Layout:
    """Return the layout of the small skin, with more tables."""
    return small_layout(16, 16, name="palm", bus=buses(4, 4, names=("left", "right")), **tables)


class FabricStub:
    """Stands for a fabric: keeps who hears messages by topic, and who hears of peers."""

    def __init__(self) -> None:
        self.malformed = 0
        self.handlers: dict[str, Callable[[Unread], None]] = {}
        self.changed: Callable[[Peer, bool], None] = print

    @property
    def fabric(self) -> Fabric:
        """This, as a fabric."""
        return cast("Fabric", self)

    def subscribe_unread(self, topic: Topic, handler: Callable[[Unread], None]) -> None:
        self.handlers[topic.name] = handler

    def watch_peers(self, changed: Callable[[Peer, bool], None]) -> None:
        self.changed = changed


@dataclass
class Messages:
    """Builds messages that fit the small skin; ``force_n`` is the peak of a round contact."""

    layout: Layout = field(default_factory=palm_layout)

    def grid(self, force_n: float = 0.01) -> npt.NDArray[np.float32]:
        rows, columns = np.mgrid[0 : self.layout.taxels.rows, 0 : self.layout.taxels.columns]
        distance = np.hypot(rows - 7.5, columns - 6.0)
        force: npt.NDArray[np.float32] = (force_n * np.clip(1 - distance / 6, 0, None)).astype("<f4")
        return force

    def image(
        self,
        cycle: int = 1,
        *,
        sync_s: float = 1.0,
        latency_s: float = 0.005,
        pixels: npt.NDArray[np.float32] | None = None,
        invalid: tuple[int, ...] = (),
    ) -> Image:
        valid = np.ones(self.layout.blocks, np.uint8)
        valid[list(invalid)] = 0
        sync_ns = round(sync_s * SECOND_NS)
        return make.image(
            cycle,
            sampled_mono_ns=sync_ns,
            published_mono_ns=sync_ns + round(latency_s * SECOND_NS),
            pixels=(self.grid() if pixels is None else pixels).tobytes(),
            valid=valid.tobytes(),
            valid_sums=int(valid.sum()) * 8,
            solve_s=0.003,
        )

    def truth(
        self,
        cycle: int = 1,
        *,
        sync_s: float = 1.0,
        true: npt.NDArray[np.float32] | None = None,
        sensor: npt.NDArray[np.float32] | None = None,
        label: str = "golf-ball",
    ) -> Truth:
        real = self.grid() if true is None else true
        return make.truth(
            cycle,
            sampled_mono_ns=round(sync_s * SECOND_NS),
            true=real.tobytes(),
            sensor=(real if sensor is None else sensor).tobytes(),
            label=label,
        )

    def contacts(
        self, cycle: int = 1, *, sync_s: float = 1.0, blind: bool = False, doubtful: bool = False, **changed: Any
    ) -> Contacts:
        force_n = float(self.grid().sum())
        contact = make.contact(**{
            "identity": 7, "row": 7.5, "column": 6.0, "force_n": force_n, "peak_n": 0.01, "taxels": 113,
            "top": 2, "bottom": 13, "left": 0, "right": 11, "onset_mono_ns": 0, "invalid_taxels": 4,
            "doubtful_since_mono_ns": int(doubtful), **changed,
        })  # fmt: skip
        return make.contacts(cycle, contact, sampled_mono_ns=round(sync_s * SECOND_NS), find_s=1e-4, blind=blind)

    def label(
        self,
        label: str = "golf-ball",
        confidence: float = 0.93,
        valid_sums: int = 64,
        *,
        cycle: int = 1,
        sync_s: float = 1.0,
    ) -> Label:
        sampled_mono_ns = round(sync_s * SECOND_NS)
        return make.label(cycle, label, sampled_mono_ns=sampled_mono_ns, confidence=confidence, valid_sums=valid_sums)

    def gateway(
        self,
        *,
        cycles: int = 10,
        missing: int = 0,
        nmt: tuple[tuple[int, ...], ...] = (),
        links: tuple[str, str] = ("active", "active"),
        troubles: tuple[str, str] = ("", ""),
        refused: tuple[int, ...] = (),
        emergencies: tuple[NodeEmergency, ...] = (),
    ) -> GatewayStatus:
        """``refused`` and ``emergencies`` are of nodes of the left bus."""
        states = nmt or ((5, 5, 5, 5), (5, 5, 5, 5))
        buses = [
            make.bus_state(
                bus.name,
                load_ratio=0.8,
                mean_load_ratio=0.8,
                nodes=list(range(1, bus.nodes + 1)),
                nmt=bytes(state),
                link=link,
                trouble=trouble,
            )
            for bus, state, link, trouble in zip(self.layout.bus, states, links, troubles, strict=True)
        ]
        buses[0] = msgspec.structs.replace(buses[0], refused=list(refused), emergencies=list(emergencies))
        return make.gateway_status(cycles, frames=FrameCounts(accepted=16 * cycles, missing=missing), buses=buses)

    def nodes(self, process: str = "nodes") -> NodesStatus:
        return make.nodes_status(process, frames_sent=160)
