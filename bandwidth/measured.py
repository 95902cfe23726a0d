"""Measured load of a bus, per node and per identifier, beside the planned load."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from bandwidth.plan import BusPlan, cycle_hz
from canskin.errors import InputError
from dbc.canopen import (
    BASE_ID_MASK,
    EXTENDED_ID_MASK,
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SERVICES,
    SYNC_COB_ID,
    TIME_COB_ID,
    identifier_text,
)
from dbc.contract import Contract
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import BRS, ERROR, EXTENDED, FD, REMOTE, Frames
from dbc.frame_bits import frame_time_ns
from skin.layout import Bus

#: Kinds of identifiers of other devices: not in the layout, and named by the layout.
FOREIGN: Final = "foreign"
OTHER_DEVICE: Final = "other device"
#: Kind of the identifiers of sums.
TPDO: Final = "TPDO"
#: A skin is never silent for so long: the clock was set, or the logging paused.
JUMP_NS: Final = 2_000_000_000
#: Most times of the median between two frames that a bus of other devices is silent.
_SILENCE: Final = 100
#: With a larger part of unknown frames, a bus does not fit the layout.
MISFIT_RATIO: Final = 0.2


@dataclass(frozen=True)
class IdentifierLoad:
    """Load of one identifier: `load_exact` from the bits of its frames, `load_worst` with the most stuff bits.

    `planned_rate_hz` is None for identifiers without a fixed rate and for identifiers that are not planned. `message`
    is the name that the layout gives a message of another device, whose kind is `OTHER_DEVICE`; None for other kinds.
    """

    cob_id: int
    is_extended: bool
    kind: str
    message: str | None
    node_id: int | None
    frames: int
    rate_hz: float
    planned_rate_hz: float | None
    load_exact: float
    load_worst: float

    @property
    def name(self) -> str:
        """The identifier in three or eight hexadecimal digits, as in logs."""
        return identifier_text(self.cob_id, is_extended=self.is_extended)


@dataclass(frozen=True)
class NodeLoad:
    """Load of all frames of one node; node-ID 0 is the gateway."""

    node_id: int
    frames: int
    load_exact: float
    load_worst: float


@dataclass(frozen=True)
class BusLoad:
    """Load of one bus, from the first SYNC to the last; without two SYNCs from the first frame to the last."""

    name: str
    seconds: float
    frames: int
    errors: int
    load_exact: float
    load_worst: float
    plan_touched: float | None
    plan_worst: float
    nodes: list[NodeLoad]
    identifiers: list[IdentifierLoad]


def whole_cycles(seen: Frames) -> tuple[Frames, float]:
    """Return the frames from the first SYNC until before the last, and the seconds between these SYNCs.

    Of frames with a silence, as where a clock was set, those of the longest part without one.

    Raise InputError unless there are two frames or more, and time passes between them.
    """
    real = seen[seen["flags"] & ERROR == 0]
    if len(real) < 2:
        raise InputError(f"expected two frames or more to measure a load, got {len(real)}")
    steps_ns = np.diff(real["time_ns"])
    edges = np.flatnonzero(steps_ns > max(JUMP_NS, _SILENCE * np.median(steps_ns))) + 1
    real = max(np.split(real, edges), key=len)
    syncs = np.flatnonzero(is_sync(real))
    first, last = (int(syncs[0]), int(syncs[-1])) if len(syncs) > 1 else (0, len(real) - 1)
    seconds = (int(real["time_ns"][last]) - int(real["time_ns"][first])) * 1e-9
    if seconds <= 0:
        raise InputError("expected frames with times that grow: the last is not later than the first")
    return real[first:last], seconds


def measure(contract: Contract, bus: int, seen: Frames, planned: BusPlan) -> BusLoad:
    """Measure the load of bus number `bus`; raise InputError if there is too little, or CAN FD that is not planned.

    Parameters
    ----------
    seen : array of FRAME
        In bus order, with times.
    """
    line = contract.layout.bus[bus]
    _check_format(line, seen)
    try:
        taken, seconds = whole_cycles(seen)
    except InputError as error:
        raise InputError(f"{line.name}: {error}") from error
    exact, worst = (
        frame_time_ns(taken, line.bitrate, line.data_bitrate, how) * (1e-9 / seconds) for how in ("exact", "worst")
    )
    rates, planned_here = planned_rates(contract, bus), Identifiers(contract, bus)
    keys = taken["can_id"] | (taken["flags"] & EXTENDED != 0).astype(np.uint32) << 31
    identifiers = []
    for key in np.unique(keys).tolist():
        mine = keys == key
        cob_id, is_extended = key & EXTENDED_ID_MASK, bool(key >> 31)
        other = planned_here.foreign.get((cob_id, is_extended))
        kind, node_id = (FOREIGN, None) if is_extended else planned_here.kind_of(cob_id)
        if other is not None:
            kind = OTHER_DEVICE
        identifiers.append(
            IdentifierLoad(
                cob_id=cob_id,
                is_extended=is_extended,
                kind=kind,
                message=None if other is None else other.name,
                node_id=node_id,
                frames=int(mine.sum()),
                rate_hz=float(mine.sum()) / seconds,
                planned_rate_hz=rates.get((cob_id, is_extended)),
                load_exact=float(exact[mine].sum()),
                load_worst=float(worst[mine].sum()),
            )
        )
    return BusLoad(
        name=line.name,
        seconds=seconds,
        frames=len(taken),
        errors=int((seen["flags"] & ERROR != 0).sum()),
        load_exact=float(exact.sum()),
        load_worst=float(worst.sum()),
        plan_touched=planned.load_touched,
        plan_worst=planned.load_worst,
        nodes=_by_node(identifiers),
        identifiers=identifiers,
    )


def planned_rates(contract: Contract, bus: int) -> dict[tuple[int, bool], float]:
    """Return the planned rate of each identifier with a fixed rate, Hz; the key tells whether it has 29 bits."""
    rate_hz = contract.layout.sync.rate_hz
    rates = {SYNC_COB_ID: rate_hz}
    if contract.layout.sync.time_s is not None:
        rates[TIME_COB_ID] = 1 / contract.layout.sync.time_s
    for node in contract.on_bus(bus):
        rates[HEARTBEAT_BASE + node.node_id] = 1000 / HEARTBEAT_MS
        if contract.layout.sends.in_cycles or contract.layout.steps.quiet == 0:
            rates |= {tpdo.cob_id: cycle_hz(contract.layout) / contract.turns for tpdo in node.tpdos}
    others = {each.key: 1 / each.period_s for each in contract.layout.bus[bus].foreign if each.period_s is not None}
    return {(cob_id, False): each_hz for cob_id, each_hz in rates.items()} | others


class Identifiers:
    """The 11-bit identifiers of a bus: what a layout plans there, and the length and format of sums."""

    def __init__(self, contract: Contract, bus: int) -> None:
        line = contract.layout.bus[bus]
        self._ids = set(line.ids)
        #: Messages of other devices, by identifier and whether it has 29 bits.
        self.foreign = {each.key: each for each in line.foreign}
        self._has_time = contract.layout.sync.time_s is not None
        self._kinds: dict[int, tuple[str, int]] = {}
        self._length, self._flags = np.zeros((2, BASE_ID_MASK + 1), np.uint8)
        self._is_sums = np.zeros(BASE_ID_MASK + 1, np.bool_)
        for node in contract.on_bus(bus):
            for tpdo in node.tpdos:
                self._kinds[tpdo.cob_id] = TPDO, node.node_id
                self._length[tpdo.cob_id], self._flags[tpdo.cob_id] = tpdo.length, node.flags & (FD | BRS)
                self._is_sums[tpdo.cob_id] = True

    def kind_of(self, cob_id: int) -> tuple[str, int | None]:
        """Return the kind of an identifier and the node-ID of its sender; 0 is the gateway."""
        if cob_id in self._kinds:
            return self._kinds[cob_id]
        if cob_id in {NMT_COB_ID, SYNC_COB_ID}:
            return ("NMT" if cob_id == NMT_COB_ID else "SYNC"), 0
        if cob_id == TIME_COB_ID and self._has_time:
            return "TIME", 0
        for base, kind in SERVICES.items():
            if cob_id - base in self._ids:
                return kind, 0 if base == SDO_REQUEST_BASE else cob_id - base
        return FOREIGN, None

    def is_sums(self, taken: Frames) -> npt.NDArray[np.bool_]:
        """Tell which frames have the identifier of sums."""
        can_id = taken["can_id"]
        found: npt.NDArray[np.bool_] = self._is_sums[can_id & BASE_ID_MASK] & (can_id <= BASE_ID_MASK)
        return found & is_plain(taken)

    def is_right(self, taken: Frames) -> npt.NDArray[np.bool_]:
        """Tell which frames have the identifier, length and format of sums."""
        can_id = taken["can_id"] & BASE_ID_MASK
        has_format = taken["flags"] & (FD | BRS) == self._flags[can_id]
        right: npt.NDArray[np.bool_] = has_format & (taken["length"] == self._length[can_id])
        return right & self.is_sums(taken)


def _by_node(identifiers: list[IdentifierLoad]) -> list[NodeLoad]:
    nodes: dict[int, list[IdentifierLoad]] = {}
    for each in identifiers:
        if each.node_id is not None:
            nodes.setdefault(each.node_id, []).append(each)
    return [
        NodeLoad(
            node_id=node_id,
            frames=sum(each.frames for each in mine),
            load_exact=sum(each.load_exact for each in mine),
            load_worst=sum(each.load_worst for each in mine),
        )
        for node_id, mine in sorted(nodes.items())
    ]


def cycles_of(taken: Frames) -> npt.NDArray[np.intp]:
    """Return the number of the cycle, from 0, of each frame of `whole_cycles`; -1 without SYNC."""
    number: npt.NDArray[np.intp] = np.cumsum(is_sync(taken)) - 1
    return number


def is_sync(seen: Frames) -> npt.NDArray[np.bool_]:
    """Tell which frames are SYNC; an extended identifier 80h is not."""
    found: npt.NDArray[np.bool_] = (seen["can_id"] == SYNC_COB_ID) & is_plain(seen)
    return found


def is_plain(seen: Frames) -> npt.NDArray[np.bool_]:
    """Tell which frames are data frames with an 11-bit identifier, like all frames of CANopen."""
    plain: npt.NDArray[np.bool_] = seen["flags"] & (EXTENDED | REMOTE | ERROR) == 0
    return plain


def misfits(contract: Contract, bus: int, seen: Frames, load: BusLoad) -> list[str]:
    """Return one line for each sign that the frames of a bus do not belong to this layout.

    Parameters
    ----------
    seen : array of FRAME
        The measured frames.
    load : BusLoad
        Result of `measure`.
    """
    hint = f"is '{contract.layout.name}' the layout of this skin? Give the right one with --layout"
    lines = []
    foreign = sum(each.frames for each in load.identifiers if each.kind == FOREIGN)
    if foreign > MISFIT_RATIO * load.frames:
        lines.append(f"{foreign} of {load.frames} frames have identifiers that the layout does not plan; {hint}")
    taken, _ = whole_cycles(seen)
    identifiers = Identifiers(contract, bus)
    tpdos = int(identifiers.is_sums(taken).sum())
    wrong = tpdos - int(identifiers.is_right(taken).sum())
    if wrong > MISFIT_RATIO * tpdos:
        lines.append(f"{wrong} of {tpdos} TPDOs have another length or format than the layout plans; {hint}")
    if load.load_exact > 1:
        rate = contract.layout.bus[bus].bitrate
        what = f"its bit rate is not the layout's {rate}, or its times are wrong"
        lines.append(f"{load.load_exact:.1%} is more than a bus carries: {what}")
    span_s = float(np.ptp(seen["time_ns"])) * 1e-9
    if span_s - load.seconds > JUMP_NS * 1e-9:
        lines.append(
            f"the loads are those of {load.seconds:.1f} s of {span_s:.1f} s: the longest part without a silence"
        )
    return [f"{load.name}: {line}" for line in lines]


def _check_format(line: Bus, seen: Frames) -> None:
    """Refuse CAN FD frames if the layout has no bit rate for them: their load would be wrong."""
    switched = seen["flags"] & BRS != 0
    if not line.fd and (fd := int((seen["flags"] & FD != 0).sum())):
        wanted, has = "classic CAN", f"{fd} of {len(seen)} frames are CAN FD"
    elif line.data_bitrate is None and switched.any():
        wanted, has = "CAN FD without a data bit rate", f"{int(switched.sum())} of {len(seen)} frames have one"
    else:
        return
    raise InputError(
        f"{line.name}: the layout has {wanted} there, but {has}: give the layout of this skin with --layout"
    )
