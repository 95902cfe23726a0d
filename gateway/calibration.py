"""The calibration of a running gateway: offsets for its measurements, and answers to requests."""

from collections import deque
from collections.abc import Mapping
from typing import Final, NamedTuple

import msgspec
import numpy as np

from calibration.calibrator import Calibrator
from calibration.stored import StoredCalibration, encoded, parse_calibration, store
from dbc.contract import Contract
from gateway.nmt_master import NmtMaster
from gateway.node_writing import NodeWriting
from skin.calibration_messages import CalibrationReply, CalibrationRequest, CalibrationStatus
from skin.errors import InputError
from skin.fabric import Reply
from skin.messages import Measurement
from skin.service import say

#: Answer to what makes no sense for boards that look after themselves.
_ADAPTIVE: Final = (
    "adaptive boards measure their offsets at power-up and follow them (docs/adaptive.md): nothing may touch them then"
)


_TOO_FEW: Final = "fewer than half of the sums are valid: the zero is measured when they are"
#: A measurement of the zero that takes longer is answered with the reason; it goes on.
PATIENCE_S: Final = 8.0


class _Request(NamedTuple):
    request: CalibrationRequest
    reply: Reply


class GatewayCalibration:
    """Calibrates a skin, and answers requests about that.

    Parameters
    ----------
    contract : Contract
    stored : StoredCalibration, optional
        What is used until the zero is measured.
    tares : bool
        Measure the zero at the start, and follow it.
    """

    def __init__(self, contract: Contract, stored: StoredCalibration | None = None, *, tares: bool = True) -> None:
        self._contract = contract
        self._stored = stored or store(contract.layout)
        self._calibrator = Calibrator(
            contract.layout,
            offsets_n=self._stored.sum_offsets_n(),
            tares=tares,
            say=lambda text: say("gateway", text),
        )
        self._requests: deque[_Request] = deque()
        self._taring: list[Reply] = []
        self._tare_until_s = 0.0
        self._writing: tuple[NodeWriting, Reply] | None = None

    def ask(self, request: CalibrationRequest, reply: Reply) -> None:
        """Take a request; from any thread. `tick` answers."""
        self._requests.append(_Request(request, reply))

    def apply(self, measurement: Measurement) -> Measurement:
        """Return a measurement with the offsets of its instant."""
        return self._calibrator.apply(measurement)

    def take(self, measurement: Measurement) -> None:
        """Learn from a measurement; most of it is left to `work`."""
        self._calibrator.take(measurement)

    def work(self) -> None:
        """Learn from what was taken; takes about a millisecond."""
        self._calibrator.work()

    def status(self) -> CalibrationStatus:
        """Return what is known, for `skin.messages.GatewayStatus`."""
        return self._calibrator.status()

    def tick(self, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        """Answer requests, write to nodes; call it many times a second."""
        while self._requests:
            self._take(*self._requests.popleft(), masters, now_s)
        result = self._calibrator.result
        if self._taring and (result is not None or now_s > self._tare_until_s):
            text = _TOO_FEW if result is None else result.text
            for reply in self._taring:
                reply(self._reply(text, is_done=result is not None and result.is_done))
            self._taring.clear()
        if self._writing is not None:
            writing, reply = self._writing
            writing.tick(now_s)
            if writing.done:
                self._writing = None
                reply(self._reply(writing.text(), is_done=writing.is_complete))

    def _take(self, request: CalibrationRequest, reply: Reply, masters: Mapping[int, NmtMaster], now_s: float) -> None:
        if request.action == "show":
            reply(self._reply(self._words()))
        elif request.action == "tare":
            if self._contract.layout.sending == "adaptive":
                reply(self._reply(_ADAPTIVE, is_done=False))
                return
            self._calibrator.tare(force=request.force)
            self._taring.append(reply)
            self._tare_until_s = now_s + PATIENCE_S
        else:
            try:
                stored = parse_calibration(request.content, self._contract.layout, "calibration")
                reply_later = self._use(stored, request.action == "write", masters, now_s)
            except InputError as error:
                reply(self._reply(str(error), is_done=False))
                return
            if reply_later is None:
                reply(self._reply("in use"))
            else:
                self._writing = (reply_later, reply)

    def _use(
        self, stored: StoredCalibration, to_nodes: bool, masters: Mapping[int, NmtMaster], now_s: float
    ) -> NodeWriting | None:
        """Use a calibration; return what writes it to the nodes, if that is wanted.

        Raises
        ------
        InputError
            If there is nothing to use or to write.
        """
        offsets_n = stored.sum_offsets_n()
        if not to_nodes:
            if offsets_n is None:
                raise InputError("the calibration has no offsets of sums: gains are used by nodes, with --to-nodes")
            if self._contract.layout.sending == "adaptive":
                raise InputError(_ADAPTIVE)
            self._calibrator.load(offsets_n)
            self._stored = stored
            return None
        if self._writing is not None:
            raise InputError("the nodes are being written to: wait for the end of that")
        gains, offsets = node_values(stored, self._contract.layout.taxels.newton_per_count)
        if gains is None and offsets is None:
            raise InputError(
                "the calibration has nothing for nodes, neither gains nor taxel_offsets_n: offsets of sums do not tell"
                " those of taxels, and stay in the gateway"
            )
        self._stored = msgspec.structs.replace(self._stored, gains=stored.gains, taxel_offsets_n=stored.taxel_offsets_n)
        return NodeWriting(self._contract, masters, gains, offsets, now_s)

    def _reply(self, text: str, *, is_done: bool = True) -> CalibrationReply:
        present = store(self._contract.layout, offsets_n=self._calibrator.offsets_n, defects=self.status().defects)
        whole = msgspec.structs.replace(present, gains=self._stored.gains, taxel_offsets_n=self._stored.taxel_offsets_n)
        return CalibrationReply(is_done=is_done, text=text, status=self.status(), content=encoded(whole))

    def _words(self) -> str:
        return _ADAPTIVE if self._contract.layout.sending == "adaptive" else "the calibration in use"


def node_values(stored: StoredCalibration, newton_per_count: float) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Return what nodes make of counts x by ``gain * x + offset``, see `skin.taxel.corrected`; None for what they keep.

    A taxel reads r = g f + o. So f = r / g - o / g.
    """
    if not stored.gains and not stored.taxel_offsets_n:
        return None, None
    factor = 1 / np.array(stored.gains) if stored.gains else None
    if not stored.taxel_offsets_n:
        return factor, None
    offsets = -np.array(stored.taxel_offsets_n) / newton_per_count
    return factor, offsets if factor is None else offsets * factor
