"""Check of a board: its objects are read, and its sums compared while it shows the test patterns.

SYNC goes on at the layout's period from the first pattern to the last: a stock stack leaves OPERATIONAL when no
SYNC comes for 1.5 periods. After each pattern is written, the board is started, and the SYNC counter begins at 1
again. So boards that use the SYNC start value once and then count are checked, too.
"""

import struct
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from typing import Final, cast

import numpy as np
import numpy.typing as npt

from bus.link import Send
from dbc import indices as od
from dbc.board import BoardTpdo, board
from dbc.board_sums import PATTERNS, node_payloads, node_sums, pattern_counts
from dbc.canopen import (
    HEARTBEAT_BASE,
    HEARTBEAT_BYTES,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    NmtCommand,
    NmtState,
    state_text,
)
from dbc.configuration import configuration, setting_of, signature
from dbc.contract import Contract, NodeContract
from dbc.dictionary import SILENT_AFTER_S, dictionary
from dbc.frame import ECHO, ERROR, REMOTE, Frames, frames, one_frame
from dbc.objects import Object
from gateway.proof import NO_SIGNATURE
from gateway.sdo import Dialogue, Read, SdoAbortedError, SdoDialogue, SdoError, Transfer, Write

#: Time in which another SYNC producer must be heard, in periods, and at least in seconds.
LISTEN_PERIODS: Final = 3
LISTEN_S: Final = 0.2
#: Longest wait for the SYNC after the last cycle: the frames of a busy computer come late, but not late on the bus.
PATIENCE_S: Final = 0.5
#: SYNC messages between the NMT start and the first cycle that is compared: a board may be slow to start.
SETTLING: Final = 2
#: SYNC messages for each test pattern.
CYCLES: Final = 4
#: A board may leave OPERATIONAL when the next SYNC comes later than this, in periods. CANopenNode does so.
LONGEST_GAP: Final = 1.5
#: How often a pattern is shown to a board that differs, where SYNC came late.
SHOWN: Final = 3
#: Serial number: a maker may have numbers of its own.
_SERIAL: Final = (od.IDENTITY, 4)
#: What a pattern is called in messages.
_NAMES: Final = {1: "zero", 2: "ramp", 3: "full scale"}


@dataclass(frozen=True)
class _Listen:
    """Wait, and get the frames that came."""

    time_s: float


@dataclass(frozen=True)
class _Cycles:
    """Start the node, let `SETTLING` SYNC messages pass, and get the frames up to the SYNC after `CYCLES` more."""


#: What a check asks for, and what it gets: frames, the value of an object, or an error.
_Step = _Listen | Transfer | _Cycles
_Answer = Frames | bytes | SdoError
_Steps = Generator[_Step, _Answer, None]


@dataclass
class NodeReport:
    """What a check has found.

    Attributes
    ----------
    bus : str
    node_id : int
    differences : list of str
        What differs from the contract; the board keeps it if there are none.
    notes : list of str
        What is allowed and costs something.
    objects, frames, cycles : int
        Number of objects, TPDOs and cycles that were compared.
    latest_s : float
        Latest end of a TPDO after the SYNC.
    """

    bus: str
    node_id: int
    differences: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    objects: int = 0
    frames: int = 0
    cycles: int = 0
    latest_s: float = 0.0


class NodeCheck:
    """Checks one node; frames in, frames out, time as an argument.

    The node is left pre-operational, with the test patterns that it had.

    Attributes
    ----------
    report : NodeReport
    done : bool
    due_s : float
        When `tick` has something to do.
    """

    def __init__(self, contract: Contract, node: NodeContract, send: Send, now_s: float) -> None:
        self._contract, self._node, self._send = contract, node, send
        self._period_s = contract.layout.sync.period_s
        self.report = NodeReport(contract.layout.bus[node.bus].name, node.node_id)
        self.done = False
        self.due_s = now_s
        self._table = board(contract, node)
        self._cob_ids = [tpdo.cob_id for tpdo in self._table.tpdos]
        #: When the next SYNC goes; infinite before the first pattern.
        self._sync_s = np.inf
        self._counter = self._idle = 1 + max(tpdo.sync_start_value for tpdo in self._table.tpdos)
        self._pattern_indices = [od.of_block(od.TEST_PATTERN, place) for place in range(node.blocks)]
        #: The test patterns that the node had.
        self._patterns: dict[int, bytes] = {}
        self._heard: list[Frames] = []
        self._dialogue: SdoDialogue | None = None
        #: When the open step ends; infinite where that depends on what comes.
        self._ends_s = now_s
        #: SYNC messages that the cycles of a pattern still need; None outside the cycles.
        self._wanted: int | None = None
        self._steps = self._check()
        self._begin(next(self._steps), now_s)

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use received frames, with the echoes of own frames."""
        arrived = arrived[(arrived["flags"] & (ERROR | REMOTE)) == 0]
        if self.done or not len(arrived):
            return
        self._heard.append(arrived)
        answers = arrived[
            (arrived["can_id"] == SDO_RESPONSE_BASE + self._node.node_id) & (arrived["flags"] & ECHO == 0)
        ]
        for each in answers:
            if self._dialogue is not None:
                self._dialogue.take(each["data"][: each["length"]].tobytes(), now_s)
        self._look(now_s)

    def tick(self, now_s: float) -> None:
        """Do what is due."""
        if self.done:
            return
        if now_s >= self._sync_s:
            self._sync(now_s)
        if self._dialogue is not None:
            self._dialogue.tick(now_s)
            self._look(now_s)
        elif now_s >= self._ends_s or self._has_all_cycles():
            self._go_on(np.concatenate([frames(0), *self._heard]), now_s)
        self.due_s = min(self._ends_s, self._sync_s)

    def _sync(self, now_s: float) -> None:
        """Send a SYNC; in the cycles of a pattern the counter is the number of the cycle, else no start value."""
        overflow = self._table.sync_overflow
        self._send_one(SYNC_COB_ID, bytes((self._counter,)) if overflow else b"")
        self._counter = self._counter + 1 if self._counter < overflow else self._idle
        if self._wanted is not None:
            self._wanted -= 1
            if self._wanted == CYCLES + 1:
                self._counter = 1
            elif self._wanted == 0:
                self._ends_s = now_s + PATIENCE_S
        self._sync_s += self._period_s
        if self._sync_s <= now_s:  # no two SYNC messages at once after a pause of this computer
            self._sync_s = now_s + self._period_s

    def _has_all_cycles(self) -> bool:
        """Tell whether the SYNC after the last cycle was on the bus: what belongs to the cycles came before it."""
        if self._wanted != 0:
            return False
        return len(_syncs(_since_start(np.concatenate([frames(0), *self._heard])))) > SETTLING + CYCLES

    def give_up(self) -> None:
        """End the test patterns without waiting for answers."""
        for index, data in self._patterns.items():
            self._send_one(SDO_REQUEST_BASE + self._node.node_id, struct.pack("<BHB4s", 0x2F, index, 0, data))
        self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)

    def _look(self, now_s: float) -> None:
        """Go on when the SDO dialogue has ended."""
        if self._dialogue is None or not self._dialogue.done:
            return
        ended, self._dialogue = self._dialogue, None
        self._go_on(ended.error or cast("bytes", ended.result), now_s)

    def _go_on(self, came: _Answer, now_s: float) -> None:
        try:
            step = self._steps.send(came)
        except StopIteration:
            self.done = True
        else:
            self._begin(step, now_s)

    def _begin(self, step: _Step, now_s: float) -> None:
        self._heard.clear()
        self._wanted = None
        if isinstance(step, _Listen):
            self._ends_s = now_s + step.time_s
        elif isinstance(step, _Cycles):
            self._nmt(NmtCommand.START)
            self._ends_s, self._wanted = np.inf, SETTLING + CYCLES + 1
        else:
            self._ends_s = np.inf
            self._dialogue = SdoDialogue(self._node.node_id, _one(step), self._send_one, now_s)
        self.due_s = min(self._ends_s, self._sync_s)

    def _send_one(self, can_id: int, data: bytes) -> None:
        self._send(one_frame(can_id, data))

    def _nmt(self, command: NmtCommand) -> None:
        self._send_one(NMT_COB_ID, bytes((command, self._node.node_id)))

    def _check(self) -> _Steps:
        heard = cast("Frames", (yield _Listen(max(LISTEN_S, LISTEN_PERIODS * self._period_s))))
        if (heard["can_id"] == SYNC_COB_ID).any():
            self._differs("another program sends SYNC on this bus: stop the gateway, then check again")
            return
        if not (yield from self._objects()) or self._node.adaptive_tpdos:
            return
        self._sync_s = -np.inf
        for pattern in PATTERNS:
            if not (yield from self._show(pattern)):
                self.give_up()
                return
        self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        for index, data in self._patterns.items():
            yield from self._write(index, data)
        self._patterns.clear()

    def _objects(self) -> Generator[_Step, _Answer, bool]:
        """Compare the objects; tell whether the node answers and can show test patterns."""
        own = [each for each in dictionary(self._contract, self._node) if _is_of_board(each)]
        settings = [*configuration(self._contract, self._node), *map(setting_of, own)]
        found: dict[tuple[int, int], bytes] = {}
        for setting in settings:
            data = yield Read(setting.index, setting.subindex)
            if isinstance(data, SdoAbortedError):
                self._differs(str(data))
                continue
            if not isinstance(data, bytes):
                self._differs(f"{data}: is the board on this bus, at this bit rate, with node-ID {self._node.node_id}?")
                return False
            self.report.objects += 1
            found[setting.index, setting.subindex] = data
            if not setting.matches(data):
                text = f"{setting} is {setting.text(data)}, expected {setting.text()}"
                is_allowed = setting.index in self._pattern_indices or (setting.index, setting.subindex) == _SERIAL
                (self.report.notes if is_allowed else self.report.differences).append(text)
        yield from self._signature(found)
        if errors := (yield from self._errors()):
            self.report.notes.append(errors.removeprefix("; "))
        self._patterns = {index: found[index, 0] for index in self._pattern_indices if (index, 0) in found}
        return len(self._patterns) == self._node.blocks

    def _signature(self, found: Mapping[tuple[int, int], bytes]) -> _Steps:
        """Compare 2006h with what it is for the values that the node has."""
        data = yield Read(od.SIGNATURE)
        value = int.from_bytes(data, "little") if isinstance(data, bytes) else NO_SIGNATURE
        covered = [(each.index, each.subindex) for each in configuration(self._contract, self._node)]
        if value == NO_SIGNATURE:
            self.report.notes.append(f"no signature ({od.SIGNATURE:04X}h): a proof reads every object")
        elif found.keys() >= set(covered):
            expected = signature((*place, found[place]) for place in covered)
            if value != expected:
                self._differs(
                    f"the signature ({od.SIGNATURE:04X}h) is {value:08X}h, expected {expected:08X}h of its objects"
                )

    def _show(self, pattern: int) -> Generator[_Step, _Answer, bool]:
        """Show a test pattern, and compare the TPDOs of some cycles; tell whether the node still answers."""
        self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        before = len(self.report.differences)
        for index in self._patterns:
            if not (yield from self._write(index, bytes((pattern,)))):
                return False
        if len(self.report.differences) > before:
            return True
        for _ in range(SHOWN):
            del self.report.differences[before:]
            came = _since_start(cast("Frames", (yield _Cycles())))
            self._compare(came, pattern)
            if len(self.report.differences) == before or _longest_gap_s(came) < LONGEST_GAP * self._period_s:
                break
            self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        if (
            len(self.report.differences) > before
            and not np.isin(came["can_id"], [tpdo.cob_id for tpdo in self._table.tpdos]).any()
        ):
            yield from self._explain_silence(before, _NAMES[pattern])
        return True

    def _explain_silence(self, before: int, name: str) -> _Steps:
        """Where a board has left OPERATIONAL, say so once in place of each TPDO that did not come."""
        heard = cast("Frames", (yield _Listen(SILENT_AFTER_S)))
        said = heard[(heard["can_id"] == HEARTBEAT_BASE + self._node.node_id) & (heard["length"] == HEARTBEAT_BYTES)]
        if len(said) and int(said["data"][-1, 0]) & 0x7F != NmtState.OPERATIONAL:
            state = state_text(int(said["data"][-1, 0]) & 0x7F)
            why = yield from self._errors()
            self.report.differences[before:] = [f"test pattern {name}: the board left OPERATIONAL for {state}{why}"]

    def _errors(self) -> Generator[_Step, _Answer, str]:
        """Return the error register and the newest error of the board in words, empty if there is none."""
        register = yield Read(od.ERROR_REGISTER)
        if not isinstance(register, bytes) or not any(register):
            return ""
        newest = yield Read(od.ERROR_FIELD, 1)
        words = f", its newest error (1003h:1) {newest[1::-1].hex().upper()}h" if isinstance(newest, bytes) else ""
        return f"; its error register (1001h) is {register.hex().upper()}h{words}"

    def _compare(self, came: Frames, pattern: int) -> None:
        """Compare the TPDOs of all cycles of a pattern."""
        size, top = self._contract.phi.block_size, self._contract.layout.taxels.count_max
        shown = np.tile(np.asarray(pattern_counts(pattern, size, top), np.float32), (self._node.blocks, 1))
        payloads = node_payloads(self._contract, self._node, node_sums(self._contract, self._node, shown))
        syncs = [*_syncs(came)[SETTLING:].tolist(), len(came)]
        for counter in range(1, CYCLES + 1):
            place = f"test pattern {_NAMES[pattern]}, SYNC {counter}"
            self.report.cycles += 1
            if counter >= len(syncs):
                self._differs(f"{place}: the SYNC was not sent")
                continue
            cycle = came[syncs[counter - 1] : syncs[counter]]
            for tpdo in self._table.tpdos:
                copies = cycle[(cycle["can_id"] == tpdo.cob_id) & (cycle["flags"] & ECHO == 0)]
                self._compare_tpdo(copies, tpdo, payloads[tpdo.cob_id], _is_due(tpdo, counter), place)
                if len(copies):
                    late_s = (int(copies["time_ns"].max()) - int(cycle["time_ns"][0])) / 1e9
                    self.report.latest_s = max(self.report.latest_s, late_s)
                    if late_s * 1e6 > self._table.sync_window_us:
                        self._differs(f"{place}: TPDO {tpdo.number} ends {late_s * 1e3:.1f} ms after SYNC, after 1007h")

    def _compare_tpdo(self, copies: Frames, tpdo: BoardTpdo, payload: bytes, is_due: bool, place: str) -> None:
        what = f"{place}: TPDO {tpdo.number} ({tpdo.cob_id:03X}h)"
        if len(copies) != is_due:
            self._differs(f"{what} came {len(copies)} times, expected {int(is_due)}")
        for each in copies[:1]:
            self.report.frames += 1
            data = each["data"][: each["length"]].tobytes()
            if data != payload:
                self._differs(f"{what} is {data.hex(' ')}, expected {payload.hex(' ')}")

    def _write(self, index: int, data: bytes) -> Generator[_Step, _Answer, bool]:
        """Write an object; tell whether the node answers."""
        answer = yield Write(index, 0, data)
        if isinstance(answer, SdoError):
            self._differs(str(answer))
        return not isinstance(answer, SdoError) or isinstance(answer, SdoAbortedError)

    def _differs(self, text: str) -> None:
        self.report.differences.append(text)


def _one(transfer: Transfer) -> Dialogue:
    """Do one transfer."""
    return (yield transfer)


def _is_of_board(each: Object) -> bool:
    """Tell whether an object is compared besides those that the gateway compares: wiring, rows, serial number."""
    if (each.index, each.subindex) == _SERIAL:
        return True
    is_of_phi = each.index >= od.MANUFACTURER and od.split_block(each.index)[1] in (od.ROWS, od.TAXELS)
    return is_of_phi and each.subindex != 0


def _syncs(came: Frames) -> npt.NDArray[np.intp]:
    """Return the places of the SYNC messages that the check has sent."""
    return np.flatnonzero((came["can_id"] == SYNC_COB_ID) & (came["flags"] & ECHO != 0))


def _since_start(came: Frames) -> Frames:
    """Return the frames from the newest NMT start of the check on, none if the start was not sent."""
    is_start = (came["can_id"] == NMT_COB_ID) & (came["flags"] & ECHO != 0) & (came["data"][:, 0] == NmtCommand.START)
    starts = np.flatnonzero(is_start)
    return came[starts[-1] :] if starts.size else came[:0]


def _longest_gap_s(came: Frames) -> float:
    """Return the longest time between two SYNC messages on the bus."""
    return float(np.diff(came["time_ns"][_syncs(came)]).max(initial=0)) / 1e9


def _is_due(tpdo: BoardTpdo, counter: int) -> bool:
    """Tell whether a TPDO answers the SYNC `counter`, the first after the start being 1."""
    return (counter - tpdo.sync_start_value) % tpdo.transmission_type == 0
