"""The calibration of a running gateway: offsets for its measurements, and answers to requests."""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Final, NamedTuple

import msgspec
import numpy as np

from calibration.calibrator import LOOK_S, Calibrator
from calibration.windows import Bools, Floats
from canskin.calibration_messages import (
    CalibrationReply,
    CalibrationRequest,
    CalibrationStatus,
    Region,
    tare_request,
)
from canskin.errors import InputError
from canskin.fabric import Reply
from canskin.messages import Measurement, SteppedMeasurement
from dbc.contract import Contract, NodeContract
from gateway.nmt_master import NmtMaster
from gateway.node_writing import NodeWriting
from gateway.temperatures import Temperatures
from shell.output import write_file
from shell.service import say
from skin.calibration_file import (
    StoredCalibration,
    encoded,
    load_calibration,
    most_offset_n,
    new_calibration,
    parse_calibration,
)
from skin.layout import Layout
from skin.regions import taxels_of

#: Answer to what makes no sense for boards that look after themselves.
_STEPPED: Final = (
    "stepped boards measure their offsets at power-up and follow them (docs/steps.md): nothing may touch them then;"
    " the gateway has the offsets that 'skin tare' has settled"
)
_TOO_FEW: Final = "fewer than half of the sums are valid: the zero is measured when they are"
#: A measurement of the zero that takes longer is answered with the reason; it goes on.
PATIENCE_S: Final = 8.0
#: Time between two writes of the zero to its file.
KEEP_S: Final = 60.0
#: Requests that wait for an answer; more are refused.
MOST_REQUESTS: Final = 8
#: Longest content of a request: bytes for each sum and taxel, and for all else.
_NUMBER_BYTES: Final = 32
_OTHER_BYTES: Final = 1 << 16


class _Request(NamedTuple):
    request: CalibrationRequest
    reply: Reply
    stored: StoredCalibration | None


class GatewayCalibration:
    """Calibrates a skin, and answers requests about that.

    Parameters
    ----------
    stored : StoredCalibration, optional
        What is used until the zero is measured.
    tares : bool
        Measure the zero at the start, and follow it.
    submit : callable
        Calls what it is given, soon, in another thread: answers take milliseconds. By default at once.
    keeps : pathlib.Path, optional
        File for the zero, see `kept_zero`.
    """

    def __init__(
        self,
        contract: Contract,
        stored: StoredCalibration | None = None,
        *,
        tares: bool = True,
        submit: Callable[[Callable[[], None]], object] = lambda function: function(),
        keeps: Path | None = None,
    ) -> None:
        self._contract, self._boards_keep_zero = contract, contract.layout.sends.boards_keep_zero
        self._submit, self._tares = submit, tares
        self._stored = stored or new_calibration(contract.layout)
        self._keeps, self._keep_at_s, self._could_not_keep = keeps, float("-inf"), False
        self._kept_n, self._now_s = self._stored.sum_offsets_n(), 0.0
        self._calibrator = Calibrator(
            contract.layout,
            offsets_n=self._stored.sum_offsets_n(),
            tares=tares,
            say=lambda text: say("gateway", text),
        )
        has_thermometers = contract.layout.taxels.has_thermometers
        self._temperatures = Temperatures(contract, self.take_temperatures) if has_thermometers else None
        #: Stepped: the newest sums, which hold until others come, and when they are looked at next.
        self._newest: SteppedMeasurement | None = None
        self._look_s = float("-inf")
        #: Nodes whose gains or offsets nobody has accepted.
        self._recalibrated: list[NodeContract] = []
        self._requests: deque[_Request] = deque()
        self._taring: list[Reply] = []
        self._wanted: tuple[bool, Region | str | None] = False, None
        self._tare_until_s = 0.0
        self._had_offsets = False
        self._writing: tuple[NodeWriting, StoredCalibration, Reply] | None = None

    def ask(self, request: CalibrationRequest, reply: Reply) -> None:
        """Take a request; from any thread. What cannot be used is refused here, `tick` answers the rest."""
        try:
            self._requests.append(_Request(request, reply, self._checked(request)))
        except InputError as error:
            reply(CalibrationReply(is_done=False, text=str(error)))

    def _checked(self, request: CalibrationRequest) -> StoredCalibration | None:
        """Return the calibration in a request."""
        if len(self._requests) + len(self._taring) >= MOST_REQUESTS:
            raise InputError(f"{MOST_REQUESTS} requests wait for an answer: ask again later")
        layout = self._contract.layout
        if request.action == "tare":
            tare_request(layout.taxels.rows, layout.taxels.columns, force=request.force, region=request.region)
            if request.region is not None:
                taxels_of(layout, request.region)
        if request.action not in {"load", "write"}:
            return None
        most = _NUMBER_BYTES * (self._contract.phi.shape[0] + 2 * layout.taxels.count) + _OTHER_BYTES
        if len(request.content) > most:
            raise InputError(f"a calibration of {len(request.content)} bytes: expected {most} at most for this skin")
        return parse_calibration(request.content, layout, "calibration")

    def apply(self, measurement: Measurement) -> Measurement:
        """Return a measurement with the offsets of its instant."""
        return self._calibrator.apply(measurement)

    def take(self, measurement: Measurement) -> None:
        """Learn from a measurement, stepped ones at the next `tick`; most of it is left to `work`."""
        if isinstance(measurement, SteppedMeasurement):
            self._newest = measurement
        else:
            self._calibrator.take(measurement)

    def take_temperatures(self, kelvin: Floats) -> None:
        """Take the temperatures of the boards, kelvin, shape (blocks,); NaN where unknown."""
        self._calibrator.take_temperatures(kelvin)

    def work(self) -> None:
        """Learn from what was taken."""
        self._calibrator.work()

    def status(self) -> CalibrationStatus:
        """Return what is known, for `canskin.messages.GatewayStatus`."""
        names = [f"{self._contract.layout.bus[each.bus].name} node {each.node_id}" for each in self._recalibrated]
        status = self._calibrator.status()
        return msgspec.structs.replace(status, told_mono_ns=round(self._now_s * 1e9), recalibrated=names)

    def look(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Drop the zero of nodes whose gains or offsets have become others; call it before measurements are applied."""
        changed = [node for master in masters.values() for node in master.recalibrated]
        if not changed:
            return
        for master in masters.values():
            master.recalibrated.clear()
        self._keep_at_s = float("-inf")
        self._calibrator.forget_blocks(self._blocks_of(changed))
        self._doubt(masters, now_s)

    def _accept(self, masters: Mapping[int, NmtMaster], now_s: float, region: Region | str | None = None) -> None:
        """Accept the gains and offsets of all nodes, or of those whose taxels are all in a region."""
        others = np.zeros(self._contract.phi.blocks, np.bool_)
        if region is not None:
            others[self._contract.phi.blocks_of(~taxels_of(self._contract.layout, region))] = True
        for node in (each for master in masters.values() for each in master.nodes.values()):
            if not (others & self._blocks_of([node.contract])).any():
                node.known.accept()
        self._doubt(masters, now_s)

    def _doubt(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Doubt the forces of nodes whose gains or offsets nobody has accepted."""
        nodes = (each for master in masters.values() for each in master.nodes.values())
        self._recalibrated = [each.contract for each in nodes if each.known.is_doubtful]
        self._calibrator.doubt_blocks(self._blocks_of(self._recalibrated), round(now_s * 1e9))

    def _blocks_of(self, nodes: Iterable[NodeContract]) -> Bools:
        blocks = np.zeros(self._contract.phi.blocks, np.bool_)
        for each in nodes:
            blocks[each.block : each.block + each.blocks] = True
        return blocks

    def keep_zero(self) -> None:
        """Write the zero, if there is a new one, to its file, in the other thread; an error is said once."""
        path, offsets_n = self._keeps, self._calibrator.offsets_n
        if path is None or offsets_n is None:
            return
        usable_n = np.where(np.abs(offsets_n) <= most_offset_n(self._contract.layout), offsets_n, np.nan)
        if self._kept_n is not None and np.array_equal(usable_n, self._kept_n, equal_nan=True):
            return
        self._kept_n = usable_n

        def write() -> None:
            try:
                write_file(path, encoded(new_calibration(self._contract.layout, offsets_n=usable_n)))
                self._could_not_keep = False
            except OSError as error:
                if not self._could_not_keep:
                    say("gateway", f"{path}: cannot keep the zero there: {error.strerror or error}")
                self._could_not_keep = True

        self._submit(write)

    def tick(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Answer a request, write to nodes, read temperatures; call it many times a second."""
        self._now_s = now_s
        if self._newest is not None and now_s >= self._look_s:
            self._look_s = now_s + LOOK_S
            self._calibrator.take(msgspec.structs.replace(self._newest, sampled_mono_ns=round(now_s * 1e9)))
        if self._keeps is not None and now_s >= self._keep_at_s and self._calibrator.offsets_n is not None:
            self._keep_at_s = now_s + KEEP_S
            self.keep_zero()
        if self._temperatures is not None:
            self._temperatures.tick(masters, now_s)
        if self._requests:
            self._take(*self._requests.popleft(), masters, now_s)
        result = self._calibrator.result
        if self._taring and (result is not None or now_s > self._tare_until_s):
            text = self._why_late() if result is None else result.text
            if result is not None and result.is_done:
                self._accept(masters, now_s, self._wanted[1])
            for reply in self._taring:
                self._answer(reply, text, is_done=result is not None and result.is_done)
            self._taring.clear()
        if self._writing is not None:
            writing, stored, reply = self._writing
            writing.tick(now_s)
            if writing.done:
                self._writing = None
                self._doubt(masters, now_s)
                self._end_writing(writing, stored, reply)

    def _take(
        self,
        request: CalibrationRequest,
        reply: Reply,
        stored: StoredCalibration | None,
        masters: Mapping[int, NmtMaster],
        now_s: float,
    ) -> None:
        try:
            if stored is not None and request.action == "write":
                self._write(stored, reply, masters, now_s)
            elif stored is not None:
                self._load(stored, reply, masters, now_s)
            elif request.action == "tare":
                self._tare(request, reply, now_s)
            else:
                self._show(reply)
        except InputError as error:
            self._answer(reply, str(error), is_done=False)

    def _tare(self, request: CalibrationRequest, reply: Reply, now_s: float) -> None:
        """Begin to measure the zero."""
        wanted = request.force, request.region
        if self._taring and wanted != self._wanted:
            raise InputError("another tare is under way: ask again when it has ended")
        self._calibrator.tare(force=request.force, region=request.region)
        self._taring.append(reply)
        self._wanted, self._tare_until_s = wanted, now_s + PATIENCE_S

    def _load(self, stored: StoredCalibration, reply: Reply, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Use a calibration, and accept what the nodes correct by themselves."""
        offsets_n = stored.required_offsets_n("calibration")
        if self._boards_keep_zero:
            raise InputError(_STEPPED)
        self._calibrator.load(offsets_n)
        self._accept(masters, now_s)
        until = f"in use until the skin has been untouched for {self._calibrator.tare_s:.3g} s and has a new zero"
        self._answer(reply, until if self._tares else "in use", is_done=True)

    def _write(self, stored: StoredCalibration, reply: Reply, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Begin to write a calibration to the nodes."""
        if self._writing is not None:
            raise InputError("the nodes are being written to: wait for the end of that")
        if self._contract.layout.taxels.is_analogue:
            raise InputError("boards that make sums in hardware take off no gains: 'skin reconstruct --gains' does")
        gains, offsets = node_values(stored, self._contract.layout.taxels.newton_per_count)
        if gains is None and offsets is None:
            raise InputError(
                "the calibration has nothing for nodes, neither gains nor taxel_offsets_n: offsets of sums do not tell"
                " those of taxels, and stay in the gateway"
            )
        self._had_offsets = self._calibrator.offsets_n is not None
        self._calibrator.forget()
        self._writing = (NodeWriting(self._contract, masters, gains, offsets, now_s), stored, reply)

    def _end_writing(self, writing: NodeWriting, stored: StoredCalibration, reply: Reply) -> None:
        """Drop offsets measured meanwhile: they are those of sums that some nodes made with other values."""
        text = writing.text()
        if writing.is_complete:
            self._stored = msgspec.structs.replace(
                self._stored,
                gains=stored.gains or self._stored.gains,
                taxel_offsets_n=stored.taxel_offsets_n or self._stored.taxel_offsets_n,
            )
        self._calibrator.forget()
        if not self._boards_keep_zero:
            if self._tares:
                text += "; the zero is measured anew"
            elif self._had_offsets:
                text += "; the offsets in the gateway were those of sums before that, and are dropped: see 'skin tare'"
        self._answer(reply, text, is_done=writing.is_complete)

    def _why_late(self) -> str:
        """Say why there is no zero yet."""
        takes_s = self._calibrator.tare_s
        if self._calibrator.has_few_sums and takes_s <= PATIENCE_S:
            return _TOO_FEW
        return f"the zero is still being measured, which takes {takes_s:.3g} s: see 'skin calibration show'"

    def _answer(self, reply: Reply, text: str, *, is_done: bool) -> None:
        answer = CalibrationReply(is_done=is_done, text=text, status=self.status())
        self._submit(lambda: reply(answer))

    def _show(self, reply: Reply) -> None:
        status, offsets_n, known = self.status(), self._calibrator.offsets_n, self._stored

        def tell() -> None:
            present = new_calibration(self._contract.layout, offsets_n=offsets_n, defects=status.defects)
            whole = msgspec.structs.replace(
                present,
                gains=known.gains,
                taxel_offsets_n=known.taxel_offsets_n,
                differential_gains=known.differential_gains,
                common_mode_gains=known.common_mode_gains,
                version=known.version,
            )
            text = _STEPPED if self._boards_keep_zero else "the calibration in use"
            reply(CalibrationReply(is_done=True, text=text, status=status, content=encoded(whole)))

        self._submit(tell)


def kept_zero(path: Path, layout: Layout, stored: StoredCalibration | None) -> StoredCalibration | None:
    """Return a calibration with the zero that an earlier run has kept: the first guess of this run.

    A file that is damaged, or of another layout, is said; the gateway starts without it.

    Parameters
    ----------
    stored : StoredCalibration or None
        What is used without a zero from before; its gains are used with one, too.
    """
    try:
        found = load_calibration(path, layout)
        found.required_offsets_n(str(path))
    except InputError as error:
        if not isinstance(error.__cause__, FileNotFoundError):  # as before the first run
            say("gateway", f"starts without the zero of an earlier run: {error}")
        return stored
    say("gateway", f"begins with the zero of {found.saved}, from {path}")
    return found if stored is None else msgspec.structs.replace(stored, offsets_n=found.offsets_n)


def node_values(stored: StoredCalibration, newton_per_count: float) -> tuple[Floats | None, Floats | None]:
    """Return what nodes make of counts x by ``gain * x + offset``, see `skin.taxel.corrected`; None for what they keep.

    A taxel reads r = g f + o. So f = r / g - o / g. Raise InputError if a node cannot hold an offset.
    """
    if not stored.gains and not stored.taxel_offsets_n:
        return None, None
    factor = 1 / np.array(stored.gains) if stored.gains else None
    if not stored.taxel_offsets_n:
        return factor, None
    offsets = -np.array(stored.taxel_offsets_n) / newton_per_count
    offsets = np.rint(offsets if factor is None else offsets * factor)
    limits = np.iinfo(np.int16)
    beyond = np.flatnonzero((offsets < limits.min) | (offsets > limits.max))
    if beyond.size:
        raise InputError(
            f"taxel_offsets_n / gains of {beyond.size} taxels, first of taxel {beyond[0]}: nodes would add"
            f" {offsets[beyond[0]]:.0f} counts, and can hold {limits.min} to {limits.max}"
        )
    return factor, offsets
