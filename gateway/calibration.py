"""The calibration of a running gateway: offsets for its measurements, and answers to requests."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

import msgspec

from calibration.calibrator import LOOK_S, Calibrator
from calibration.keeping import KeptZero
from calibration.requests import Request, Requests
from calibration.windows import Floats
from canskin.calibration_messages import CalibrationReply, CalibrationRequest, CalibrationStatus, ZeroRequest
from canskin.errors import InputError
from canskin.fabric import Reply
from canskin.messages import Measurement, NodeFault, SteppedMeasurement
from dbc.contract import Contract
from gateway.doubted_nodes import DoubtedNodes
from gateway.frozen_boards import FrozenBoards
from gateway.nmt_master import NmtMaster
from gateway.node_writing import NodeWriting, node_values
from gateway.temperatures import Temperatures
from shell.service import say
from skin.calibration_file import StoredCalibration, encoded, new_calibration

#: Answer to what makes no sense for boards that look after themselves.
_STEPPED: Final = (
    "stepped boards measure their offsets at power-up and follow them (docs/steps.md): nothing may touch them then;"
    " the gateway has the offsets that 'skin tare' has settled"
)


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
        File for the zero, see `calibration.keeping.kept_zero`.
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
        layout = contract.layout
        self._contract, self._boards_keep_zero = contract, layout.sends.boards_keep_zero
        self._submit, self._tares = submit, tares
        self._stored = stored or new_calibration(layout)
        offsets_n = self._stored.sum_offsets_n()
        self._keeps = None if keeps is None else KeptZero(keeps, layout, offsets_n, submit)
        self._calibrator = Calibrator(
            layout, offsets_n=offsets_n, tares=tares, say=lambda text: say("gateway", text), submit=submit
        )
        self._temperatures = Temperatures(contract, self.take_temperatures) if layout.taxels.has_thermometers else None
        #: Stepped: the newest sums, which hold until others come, and when they are looked at next.
        self._look_s, self._now_s = float("-inf"), 0.0
        self._doubted = DoubtedNodes(contract)
        self._frozen = FrozenBoards(contract, lambda text: say("gateway", text))
        self._latest: Measurement | None = None
        self._requests = Requests(layout, self._calibrator)
        #: What is written to the nodes, for whom, and whether the gateway had offsets before.
        self._writing: tuple[NodeWriting, Request, bool] | None = None

    def ask(self, request: CalibrationRequest | ZeroRequest, reply: Reply) -> None:
        """Take a request; from any thread. What cannot be used is refused here, `tick` answers the rest."""
        self._requests.ask(request, reply)

    def apply(self, measurement: Measurement) -> Measurement:
        """Return a measurement with the offsets of its instant."""
        return self._calibrator.apply(measurement)

    def frozen_on(self, bus: int) -> dict[int, NodeFault]:
        """Return the faults of the boards of a bus whose values stand still while their frames go on, by node-ID."""
        return self._frozen.on_bus(bus)

    def take(self, measurement: Measurement) -> None:
        """Learn from a measurement, stepped ones at the next `tick`; most of it is left to `work`."""
        self._latest = measurement
        if not isinstance(measurement, SteppedMeasurement):
            self._calibrator.take(measurement)

    def take_temperatures(self, kelvin: Floats) -> None:
        """Take the temperatures of the boards, kelvin, shape (blocks,); NaN where unknown."""
        self._calibrator.take_temperatures(kelvin)

    def work(self) -> None:
        """Learn from what was taken."""
        self._calibrator.work()

    def status(self) -> CalibrationStatus:
        """Return what is known, for `canskin.messages.GatewayStatus`."""
        told_ns = round(self._now_s * 1e9)
        return msgspec.structs.replace(
            self._calibrator.status(), told_mono_ns=told_ns, recalibrated=self._doubted.names
        )

    def look(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Drop the zero of nodes whose gains or offsets have become others; call it before measurements are applied."""
        if not any(master.recalibrated for master in masters.values()):
            return
        changed = self._doubted.changed(masters)
        if self._keeps is not None:
            self._keeps.hasten()
        self._calibrator.forget_blocks(changed)
        self._doubt(masters, now_s)

    def _doubt(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        self._calibrator.doubt_blocks(self._doubted.find(masters), round(now_s * 1e9))

    def keep_zero(self) -> None:
        """Write the zero, if there is a new one, to its file, in the other thread; an error is said once."""
        if self._keeps is not None:
            self._keeps.keep(self._calibrator.offsets_n)

    def _look(self, masters: Mapping[int, NmtMaster], newest: Measurement, now_s: float) -> None:
        """Learn from the newest stepped measurement, and find frozen boards."""
        if isinstance(newest, SteppedMeasurement):
            self._calibrator.take(msgspec.structs.replace(newest, sampled_mono_ns=round(now_s * 1e9)))
        if self._frozen.tick(masters, newest, self._calibrator.stands_still, now_s):
            self._calibrator.leave_out(self._frozen.blocks)

    def tick(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Answer a request, write to nodes, read temperatures; call it many times a second."""
        self._now_s = now_s
        if self._latest is not None and now_s >= self._look_s:
            self._look_s = now_s + LOOK_S
            self._look(masters, self._latest, now_s)
        if self._keeps is not None:
            self._keeps.tick(self._calibrator.offsets_n, now_s)
        if self._temperatures is not None:
            self._temperatures.tick(masters, now_s)
        asked = self._requests.next()
        if asked is not None:
            try:
                self._take(asked, masters, now_s)
            except InputError as error:
                self._answer(asked.reply, str(error), is_done=False)
        ended = self._requests.ended(now_s)
        if ended is not None:
            if ended.is_done:
                self._doubted.accept(masters, ended.region)
                self._doubt(masters, now_s)
            for reply in ended.replies:
                self._answer(reply, ended.text, is_done=ended.is_done)
        self._go_on_writing(masters, now_s)

    def _take(self, asked: Request, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Begin what is asked for; raise InputError if that cannot be done."""
        request, reply, stored = asked
        if isinstance(request, ZeroRequest):
            self._show(reply)
        elif stored is None:
            self._requests.tare(request, reply, now_s)
        elif request.action == "write":
            self._writing = self._begin_writing(asked, stored, masters, now_s)
        else:
            self._load(stored, reply, masters, now_s)

    def _load(self, stored: StoredCalibration, reply: Reply, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Use a calibration, and accept what the nodes correct by themselves."""
        offsets_n = stored.required_offsets_n("calibration")
        if self._boards_keep_zero:
            raise InputError(_STEPPED)
        self._calibrator.load(offsets_n)
        self._doubted.accept(masters)
        self._doubt(masters, now_s)
        until = f"in use until the skin has been untouched for {self._calibrator.tare_s:.3g} s and has a new zero"
        self._answer(reply, until if self._tares else "in use", is_done=True)

    def _begin_writing(
        self, asked: Request, stored: StoredCalibration, masters: Mapping[int, NmtMaster], now_s: float
    ) -> tuple[NodeWriting, Request, bool]:
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
        had_offsets = self._calibrator.offsets_n is not None
        self._calibrator.forget()
        return NodeWriting(self._contract, masters, gains, offsets, now_s), asked, had_offsets

    def _go_on_writing(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        if self._writing is None:
            return
        writing, asked, had_offsets = self._writing
        writing.tick(now_s)
        if writing.done:
            self._writing = None
            self._doubt(masters, now_s)
            self._end_writing(writing, asked, had_offsets=had_offsets)

    def _end_writing(self, writing: NodeWriting, asked: Request, *, had_offsets: bool) -> None:
        """Drop offsets measured meanwhile: they are those of sums that some nodes made with other values."""
        text, stored = writing.text(), asked.stored
        if writing.is_complete and stored is not None:
            self._stored = msgspec.structs.replace(
                self._stored,
                gains=stored.gains or self._stored.gains,
                taxel_offsets_n=stored.taxel_offsets_n or self._stored.taxel_offsets_n,
            )
        self._calibrator.forget()
        if not self._boards_keep_zero:
            if self._tares:
                text += "; the zero is measured anew"
            elif had_offsets:
                text += "; the offsets in the gateway were those of sums before that, and are dropped: see 'skin tare'"
        self._answer(asked.reply, text, is_done=writing.is_complete)

    def _answer(self, reply: Reply, text: str, *, is_done: bool) -> None:
        answer = CalibrationReply(is_done=is_done, text=text, status=self.status())
        self._submit(lambda: reply(answer))

    def _show(self, reply: Reply) -> None:
        status, offsets_n, known = self.status(), self._calibrator.offsets_n, self._stored

        def tell() -> None:
            present = new_calibration(self._contract.layout, offsets_n=offsets_n, defects=status.defects)
            whole = msgspec.structs.replace(
                known, skin=present.skin, saved=present.saved, offsets_n=present.offsets_n, defects=present.defects
            )
            text = _STEPPED if self._boards_keep_zero else "the calibration in use"
            reply(CalibrationReply(is_done=True, text=text, status=status, content=encoded(whole)))

        self._submit(tell)
