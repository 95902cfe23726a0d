"""Check of a board: its objects are read, and its frames compared while it shows test patterns.

After each pattern is written, the board is started, and the SYNC counter begins at 1 again. So boards that use the SYNC
start value once and then count are checked, too.

What is written is put back at the end, also when the check is stopped.
"""

from collections.abc import Generator, Iterable
from functools import partial
from typing import Final, cast

import numpy as np

from bus.link import Send
from commissioning.check_steps import Answer, CheckSteps, Cycles, Listen, Step, Steps
from commissioning.node_frames import NodeReport, Picture, SynchronousFrames, syncs_of
from commissioning.stepped_node_frames import SteppedFrames
from dbc import indices as od
from dbc.board import board
from dbc.canopen import (
    HEARTBEAT_BASE,
    HEARTBEAT_BYTES,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SYNC_COB_ID,
    NmtCommand,
    NmtState,
    state_text,
)
from dbc.configuration import Setting, calibration, configuration, setting_of, signature, with_calibration
from dbc.contract import Contract, NodeContract
from dbc.dictionary import SILENT_AFTER_S, dictionary
from dbc.frame import Frames
from dbc.objects import Object
from gateway.proof import NO_SIGNATURE
from gateway.sdo import Read, SdoAbortedError, SdoError, Write

#: Time in which another SYNC producer must be heard, in periods, and at least in seconds.
LISTEN_PERIODS: Final = 3
LISTEN_S: Final = 0.2
#: A board may leave OPERATIONAL when the next SYNC comes later than this, in periods. CANopenNode does so.
LONGEST_GAP: Final = 1.5
#: How often a pattern is shown to a board that differs, where SYNC came late.
SHOWN: Final = 3
#: Serial number: a maker may have numbers of its own.
_SERIAL: Final = (od.IDENTITY, 4)
#: Objects that a user may have set.
_ALLOWED: Final = {_SERIAL, (od.TEST_PATTERN, 0), (od.SENDING, 1), (od.SENDING, 3)}
#: Objects that are read, and compared with nothing: noise of a stepped board.
_ONLY_READ: Final = ((od.NODE_NOISE, 0),)
#: Only a board knows which values are right.
_GAINS: Final = (od.GAIN, od.OFFSET)


class NodeCheck(CheckSteps):
    """Checks one node; frames in, frames out, time as an argument.

    The node is left pre-operational, with the test patterns, gains and offsets that it had.

    Attributes
    ----------
    report : NodeReport
    done : bool
    due_s : float
        When `tick` has something to do.
    """

    def __init__(self, contract: Contract, node: NodeContract, send: Send, now_s: float) -> None:
        self._contract = contract
        self.report = NodeReport(contract.layout.bus[node.bus].name, node.node_id)
        tpdos = board(contract, node).tpdos
        self._cob_ids = [tpdo.cob_id for tpdo in tpdos]
        #: The values of objects by index and sub-index, and those that have to be put back.
        self._values: dict[tuple[int, int], bytes] = {}
        self._undo: dict[tuple[int, int], bytes] = {}
        expected = (SteppedFrames if node.in_steps else SynchronousFrames)(contract, node, self.report)
        idle = 1 + max(tpdo.sync_start_value for tpdo in tpdos)
        super().__init__(node, expected, send, now_s, period_s=contract.layout.sync.period_s, idle=idle)

    def _work(self) -> Steps:
        period_s = self._contract.layout.sync.period_s
        heard = cast("Frames", (yield Listen(max(LISTEN_S, LISTEN_PERIODS * period_s))))
        if (heard["can_id"] == SYNC_COB_ID).any():
            self._differs("another program sends SYNC on this bus: stop the gateway, then check again")
            return
        if not (yield from self._objects()):
            return
        self._begin_sync()
        for picture in self._expected.pictures(has_gains=(od.GAIN, 1) in self._values):
            if not (yield from self._show(picture)):
                self._nmt(NmtCommand.RESET_NODE)
                return
        yield from self._restore()

    def _restore(self) -> Steps:
        """Put back what was written."""
        self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
        has_gains = any(od.split_block(index)[1] in _GAINS for index, _ in self._undo)
        for place, data in list(self._undo.items()):
            if not (yield from self._write(place, data)):
                self._nmt(NmtCommand.RESET_NODE)
                return
        self._undo.clear()
        if has_gains:
            yield from self._gains_signature(", with its gains and offsets put back")

    def _objects(self) -> Generator[Step, Answer, bool]:
        """Compare the objects; tell whether the node answers and can show test patterns."""
        own = [each for each in dictionary(self._contract, self._node) if _is_of_board(each)]
        settings = [*configuration(self._contract, self._node), *map(setting_of, own)]
        for setting in settings:
            data = yield Read(setting.index, setting.subindex, setting.data_type)
            if isinstance(data, SdoAbortedError):
                self._differs(str(data))
                continue
            if not isinstance(data, bytes):
                self._differs(f"{data}: is the board on this bus, at this bit rate, with node-ID {self._node.node_id}?")
                return False
            self.report.objects += 1
            self._values[setting.index, setting.subindex] = data
            if data != setting.data and (setting.index, setting.subindex) not in _ONLY_READ:
                text = f"{setting} is {setting.text(data)}, expected {setting.text()}"
                is_allowed = (od.split_block(setting.index)[1], setting.subindex) in _ALLOWED
                (self.report.notes if is_allowed else self.report.differences).append(text)
        yield from self._signature(od.SIGNATURE, configuration(self._contract, self._node))
        yield from self._gains()
        if errors := (yield from self._errors()):
            self.report.notes.append(errors.removeprefix("; "))
        return all((od.of_block(od.TEST_PATTERN, place), 0) in self._values for place in range(self._node.blocks))

    def _gains(self) -> Steps:
        """Read gains and offsets, and their signature; a board need not have them."""
        found: dict[tuple[int, int], bytes] = {}
        settings = calibration(self._contract, self._node)
        for setting in settings:
            data = yield Read(setting.index, setting.subindex, setting.data_type)
            if not isinstance(data, bytes):
                note = f"{data}: not every row is compared without gains and offsets"
                (self.report.notes if isinstance(data, SdoAbortedError) else self.report.differences).append(note)
                return
            found[setting.index, setting.subindex] = data
        self.report.objects += len(found)
        self._values |= found
        if settings:
            yield from self._gains_signature()

    def _gains_signature(self, when: str = "") -> Steps:
        covered = with_calibration(configuration(self._contract, self._node), calibration(self._contract, self._node))
        yield from self._signature(od.CALIBRATION_SIGNATURE, covered, when)

    def _signature(self, index: int, settings: Iterable[Setting], when: str = "") -> Steps:
        """Compare 2006h or 2009h with what it is for the values that the node has."""
        data = yield Read(index, 0, od.UNSIGNED32)
        value = int.from_bytes(data, "little") if isinstance(data, bytes) else NO_SIGNATURE
        covered = [(each.index, each.subindex) for each in settings]
        if value == NO_SIGNATURE:
            note = f"no signature ({index:04X}h): a proof reads every object"
            self.report.notes += [note] * (note not in self.report.notes)
        elif self._values.keys() >= set(covered):
            expected = signature((*place, self._values[place]) for place in covered)
            if value != expected:
                self._differs(
                    f"the signature ({index:04X}h) is {value:08X}h, expected {expected:08X}h of its objects{when}"
                )

    def _show(self, picture: Picture) -> Generator[Step, Answer, bool]:
        """Show a picture, and compare the frames; tell whether the node still answers."""
        before, begin = len(self.report.differences), self._start
        if picture.is_step:
            ((place, data),) = picture.values.items()
            self._undo.setdefault(place, self._values[place])
            self._values[place] = data
            begin = partial(Cycles, SDO_REQUEST_BASE + self._node.node_id, Write(*place, data).request)
        else:
            self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
            for place, data in picture.values.items():
                if self._values.get(place) != data and not (yield from self._write(place, data)):
                    return False
            if len(self.report.differences) > before:
                return True
            if any(od.split_block(index)[1] in _GAINS for index, _ in picture.values):
                yield from self._gains_signature(", with other gains and offsets")
            if self._expected.rest_s:
                yield Listen(self._expected.rest_s)
        before = len(self.report.differences)
        for _ in range(SHOWN):
            del self.report.differences[before:]
            came = self._since_begin(cast("Frames", (yield begin())))
            self._expected.compare(came, picture, self._values)
            is_late = _longest_gap_s(came) >= LONGEST_GAP * self._contract.layout.sync.period_s
            if len(self.report.differences) == before or not is_late or picture.is_step:
                break
            self._nmt(NmtCommand.ENTER_PRE_OPERATIONAL)
            begin = self._start
        if len(self.report.differences) > before and not np.isin(came["can_id"], self._cob_ids).any():
            yield from self._explain_silence(before, picture.name)
        return True

    def _start(self) -> Cycles:
        return Cycles(NMT_COB_ID, bytes((NmtCommand.START, self._node.node_id)))

    def _explain_silence(self, before: int, name: str) -> Steps:
        """Where a board has left OPERATIONAL, say so once in place of each TPDO that did not come."""
        heard = cast("Frames", (yield Listen(SILENT_AFTER_S)))
        said = heard[(heard["can_id"] == HEARTBEAT_BASE + self._node.node_id) & (heard["length"] == HEARTBEAT_BYTES)]
        if len(said) and int(said["data"][-1, 0]) & 0x7F != NmtState.OPERATIONAL:
            state = state_text(int(said["data"][-1, 0]) & 0x7F)
            why = yield from self._errors()
            self.report.differences[before:] = [f"{name}: the board left OPERATIONAL for {state}{why}"]

    def _errors(self) -> Generator[Step, Answer, str]:
        """Return the error register and the newest error of the board in words, empty if there is none."""
        register = yield Read(od.ERROR_REGISTER, 0, od.UNSIGNED8)
        if not isinstance(register, bytes) or not any(register):
            return ""
        newest = yield Read(od.ERROR_FIELD, 1, od.UNSIGNED32)
        words = f", its newest error (1003h:1) {newest[1::-1].hex().upper()}h" if isinstance(newest, bytes) else ""
        return f"; its error register (1001h) is {register.hex().upper()}h{words}"

    def _write(self, place: tuple[int, int], data: bytes) -> Generator[Step, Answer, bool]:
        """Write an object, and note what has to be put back; tell whether the node answers."""
        if place in self._values:
            self._undo.setdefault(place, self._values[place])
        answer = yield Write(*place, data)
        if isinstance(answer, SdoError):
            self._differs(str(answer))
        else:
            self._values[place] = data
        return not isinstance(answer, SdoError) or isinstance(answer, SdoAbortedError)

    def _differs(self, text: str) -> None:
        self.report.differences.append(text)


def _is_of_board(each: Object) -> bool:
    """Tell whether an object is read besides those that the gateway compares: wiring, rows, way of sending, serial."""
    if (each.index, each.subindex or 0) in (_SERIAL, *_ONLY_READ):
        return True
    return od.split_block(each.index)[1] in (od.ROWS, od.TAXELS, od.SENDING) and each.subindex != 0


def _longest_gap_s(came: Frames) -> float:
    """Return the longest time between two SYNC messages on the bus."""
    return float(np.diff(came["time_ns"][syncs_of(came)]).max(initial=0)) / 1e9
