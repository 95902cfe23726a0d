"""The frames of an adaptive board in a check: what each must tell, and which must come.

Each frame must tell the sums of the picture. Only the board knows the offsets that its filter takes off: they are
learned from full scale, which comes first. A board may filter otherwise: a sum may differ by that part of the noise
which is not worth a frame (2031h:1). What timing decides is how often a group comes. After a start each group must come
in a coarse frame first, then in a fine one; after the step to zero, in a coarse frame as news.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc import indices as od
from dbc.adaptive import (
    FINE_LIMIT,
    GROUP_SUMS,
    NO_CHECK,
    SendingRule,
    coarse_code,
    coarse_step,
    hold,
    part_of,
    parts_of,
)
from dbc.board_sums import PATTERN_FULL, PATTERN_OFF, PATTERN_ZERO
from dbc.contract import AdaptiveTpdo, Contract, NodeContract
from dbc.frame import ECHO, Frames
from gateway.node_frames import SETTLING, ExpectedFrames, NodeReport, Picture, Values, syncs_of
from skin.walsh import walsh_matrix

#: Time in which the filter comes to rest: then sums err by a third of what is not worth a frame.
_REST_S: Final = 0.3
#: Most variance of the forecast of a coefficient at rest, in units of the noise's.
_VARIANCE_AT_REST: Final = 0.1
#: A difference that is this number of times the threshold of news is news for every filter, and its steps likewise.
_CERTAIN: Final = 4.0
_CERTAIN_STEPS: Final = 2
#: The highest level of a frame that is no news: a refresh may have waited for the bus.
_REFRESH_LEVEL: Final = 1

_Floats = npt.NDArray[np.float64]


class _Sent(NamedTuple):
    """A frame of the board, and whether the board has had time to follow the picture."""

    tpdo: AdaptiveTpdo
    data: npt.NDArray[np.uint8]
    length: int
    is_settled: bool


class AdaptiveFrames(ExpectedFrames):
    """The frames of a board that sends when it has news."""

    rest_s = _REST_S
    _patterns = (PATTERN_FULL, PATTERN_OFF, PATTERN_ZERO)

    def __init__(self, contract: Contract, node: NodeContract, report: NodeReport) -> None:
        super().__init__(contract, node, report)
        taxels, size = contract.layout.taxels, contract.phi.block_size
        self._law, self._groups = contract.law, contract.layout.groups
        self._top_n = taxels.count_max * taxels.newton_per_count
        self._tpdos = {tpdo.cob_id: tpdo for tpdo in node.adaptive_tpdos}
        self._is_fd, self._walsh = node.adaptive_tpdos[0].is_fd, walsh_matrix(size).astype(np.float64)
        #: What a receiver holds: newest values, those of the newest coarse frames, and the checks of these.
        self._value_n, self._coarse_n = np.zeros((2, size))
        self._check = np.full(self._groups, NO_CHECK, np.int64)
        #: What the taxels read at full scale; the sums of the picture, and by how much they may differ.
        self._full_n, self._expected_n, self._slack_n = np.zeros((3, size))
        #: How well full scale is known, sums.
        self._error_n = np.zeros(size)

    def period_s(self, state: int) -> float:  # noqa: ARG002  one state
        """Return the time between two SYNC messages."""
        return self._contract.layout.sync.period_s

    def compare(self, came: Frames, picture: Picture, state: int, values: Values) -> None:  # noqa: ARG002
        """Compare every frame of a picture, and what came with what had to come."""
        told = values.get((od.NODE_NOISE, 0), bytes(4))
        noise_n = float(np.frombuffer(told, "<f4")[0]) if len(told) == 4 else np.nan
        if not 0 <= noise_n < np.inf:
            self._differs(f"{picture.name}: the noise ({od.NODE_NOISE:04X}h) is no number of newtons: {told.hex(' ')}")
            return
        syncs = syncs_of(came)
        if len(syncs) < SETTLING:
            self._differs(f"{picture.name}: the SYNC was not sent")
            return
        settled = int(syncs[SETTLING - 1]) if picture.is_step else 0
        own = np.flatnonzero(np.isin(came["can_id"], list(self._tpdos)) & (came["flags"] & ECHO == 0))
        sent = [
            _Sent(self._tpdos[int(each["can_id"])], each["data"].copy(), int(each["length"]), bool(at >= settled))
            for at, each in zip(own, came[own], strict=True)
        ]
        self._report.frames += len(sent)
        before_n, unsent_n = self._expected_n, SendingRule().noise_ratio * noise_n * len(self._value_n) ** 0.5
        if picture.values[od.TEST_PATTERN, 0] == bytes((PATTERN_FULL,)):
            self._learn(sent, picture.name, unsent_n)
        else:
            shown_n = picture.counts[0] * (self._top_n / self._contract.layout.taxels.count_max)
            read_n = np.where(shown_n > 0, np.maximum(0, shown_n - self._top_n + self._full_n), 0)
            self._expected_n = self._walsh @ read_n
        self._slack_n = unsent_n + (0 * self._error_n if picture.is_step else self._error_n)
        wanted = {
            tpdo.group: sums
            for tpdo in self._tpdos.values()
            if self._is_news(sums := _sums_of(tpdo), before_n, noise_n) or not picture.is_step
        }
        self._compare_frames(sent, picture)
        self._compare_groups(sent, picture, wanted)

    def _compare_frames(self, sent: Sequence[_Sent], picture: Picture) -> None:
        """Compare each frame; name the first wrong one of a group and kind."""
        begun, told = set[int](), set[tuple[int, bool]]()
        for each in sent:
            tpdo = each.tpdo
            text = self._wrong(each, is_first=tpdo.group not in begun and not picture.is_step)
            if each.is_settled:
                begun.add(tpdo.group)
            if text and (tpdo.group, tpdo.is_fine) not in told:
                told.add((tpdo.group, tpdo.is_fine))
                self._differs(f"{picture.name}: TPDO {tpdo.number} ({tpdo.cob_id:03X}h) {text}")

    def _compare_groups(self, sent: Sequence[_Sent], picture: Picture, wanted: dict[int, slice]) -> None:
        """Compare what came with what had to come of groups; news must have come before the board is at rest."""
        for group, sums in wanted.items():
            of_group = [each for each in sent if each.tpdo.group == group]
            if all(each.tpdo.is_fine or (picture.is_step and each.is_settled) for each in of_group):
                when = "as news of the step" if picture.is_step else "after the NMT start"
                self._differs(f"{picture.name}: no coarse frame of group {group} came {when}")
            elif not any(each.tpdo.is_fine for each in of_group) and (self._is_fd or self._is_in_reach(sums)):
                self._differs(f"{picture.name}: no fine frame of group {group} came")

    def _wrong(self, sent: _Sent, *, is_first: bool) -> str:
        """Take a frame; return what is wrong with it, empty if nothing is."""
        tpdo = sent.tpdo
        if sent.length != tpdo.length:
            return f"has {sent.length} bytes, expected {tpdo.length}"
        if not self._hold(sent):
            return "has another check than that of the newest coarse frame of its group"
        if is_first and tpdo.is_fine:
            return "came first after the NMT start, expected a coarse frame"
        if not is_first and sent.is_settled and tpdo.level > _REFRESH_LEVEL:
            return f"has level {tpdo.level} without news, expected 0"
        return self._wrong_sum(sent) if sent.is_settled else ""

    def _wrong_sum(self, sent: _Sent) -> str:
        """Return which sum of a frame is wrong, empty if none is."""
        for part in range(parts_of(sent.tpdo.is_fine, self._is_fd, self._groups)):
            group, is_fine = part_of(part, sent.tpdo.group, sent.tpdo.is_fine, self._is_fd, self._groups)
            for place in range(GROUP_SUMS):
                at, code = GROUP_SUMS * group + place, int(sent.data[GROUP_SUMS * part + place])
                if not (self._is_right_fine(at) if is_fine else self._is_right_code(at, code)):
                    told_n = (self._value_n if is_fine else self._coarse_n)[at]
                    return f"tells {1e3 * told_n:.2f} mN as sum {at + 1}, expected {1e3 * self._expected_n[at]:.2f} mN"
        return ""

    def _hold(self, sent: _Sent) -> bool:
        """Take a frame as a receiver does; tell whether the frame has the right check."""
        held = self._value_n, self._coarse_n, self._check
        return bool(hold(sent.data, sent.tpdo.group, sent.tpdo.is_fine, self._is_fd, self._law, *held))

    def _is_right_code(self, at: int, code: int) -> bool:
        least_n, most_n = self._expected_n[at] - self._slack_n[at], self._expected_n[at] + self._slack_n[at]
        return bool(coarse_code(least_n, at == 0, self._law) <= code <= coarse_code(most_n, at == 0, self._law))

    def _is_right_fine(self, at: int) -> bool:
        """Compare the newest value of a sum; a CAN FD frame tells the nearest value in reach of its code."""
        expected_n, fine_n, reach_n = self._expected_n[at], self._law.fine_n, FINE_LIMIT * self._law.fine_n
        allowed_n = self._slack_n[at] + fine_n / 2
        if self._is_fd:
            allowed_n += max(0.0, abs(expected_n - self._coarse_n[at]) - reach_n + fine_n)
        return bool(abs(self._value_n[at] - expected_n) <= allowed_n)

    def _learn(self, sent: Sequence[_Sent], name: str, unsent_n: float) -> None:
        """Learn from all frames what the board reads at full scale."""
        held = self._value_n.copy(), self._coarse_n.copy(), self._check.copy()
        fine = set[int]()
        for each in sent:
            if each.length == each.tpdo.length and self._hold(each) and each.tpdo.is_fine:
                fine |= {*each.tpdo.groups}
        self._expected_n = self._value_n.copy()
        for at, coarse_n in enumerate(self._coarse_n):
            half_n = coarse_step(coarse_n, at == 0, self._law) / 2
            is_exact = at // GROUP_SUMS in fine and half_n < FINE_LIMIT * self._law.fine_n
            self._error_n[at] = self._law.fine_n / 2 if is_exact else half_n
        self._value_n, self._coarse_n, self._check = held
        self._full_n = self._walsh.T @ self._expected_n / len(self._expected_n)
        error_n = float(np.mean(self._error_n + unsent_n))
        wrong = np.flatnonzero((self._full_n < -error_n) | (self._full_n > self._top_n + error_n))
        if np.median(self._full_n) < self._top_n / 2:
            self._differs(f"{name}: half of the taxels read less than half of full scale")
        elif wrong.size:
            read_n = self._full_n[wrong[0]]
            self._differs(
                f"{name}: place {wrong[0]} reads {1e3 * read_n:.2f} mN, expected 0 to {1e3 * self._top_n:.2f}"
            )

    def _is_news(self, sums: slice, before_n: _Floats, noise_n: float) -> bool:
        """Tell whether a step is news for every filter at rest: its difference is far above the threshold."""
        rule = SendingRule()
        per_sum = rule.noise_ratio**2 + rule.variance_ratio * _VARIANCE_AT_REST
        away_n = np.abs(before_n - self._expected_n)
        for at in range(len(away_n)):
            is_small = away_n[at] < _CERTAIN_STEPS * coarse_step(before_n[at], at == 0, self._law)
            away_n[at] = 0 if is_small else away_n[at]
        groups_n2 = np.square(away_n[sums]).reshape(-1, GROUP_SUMS).sum(axis=1)
        return bool(groups_n2.max() > _CERTAIN * GROUP_SUMS * len(away_n) * noise_n**2 * per_sum)

    def _is_in_reach(self, sums: slice) -> bool:
        """Tell whether a fine frame can tell all sums of a group, whatever their codes."""
        return all(
            coarse_step(self._expected_n[at], at == 0, self._law) / 2 + self._slack_n[at]
            < FINE_LIMIT * self._law.fine_n
            for at in range(sums.start, sums.stop)
        )


def _sums_of(tpdo: AdaptiveTpdo) -> slice:
    """Return the places of the sums of a TPDO."""
    return slice(GROUP_SUMS * tpdo.groups.start, GROUP_SUMS * tpdo.groups.stop)
