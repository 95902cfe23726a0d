"""The frames of a stepped board in a check: a receiver as the gateway has it (`gateway.stepped_state`) takes them.

After a start, sets must tell the sums of the picture; after the step to zero, steps must lead there. Only the board
knows the offsets that its filter takes off: they are learned from full scale, which comes first. A board may filter
otherwise: a sum may differ by that part of the noise which is not worth a frame.
"""

from typing import Final

import numpy as np
import numpy.typing as npt

from commissioning.node_frames import CYCLES, SETTLING, ExpectedFrames, NodeReport, Picture, Values, syncs_of
from dbc import indices as od
from dbc import steps
from dbc.board_sums import PATTERN_FULL, PATTERN_OFF, PATTERN_ZERO
from dbc.canopen import NMT_COB_ID, SYNC_COB_ID, NmtCommand
from dbc.contract import Contract, NodeContract, Tpdo
from dbc.frame import ECHO, Frames
from gateway.batch import batch_of
from gateway.stepped_state import AFTER_GAP, DUPLICATE, LATE, MALFORMED, forget, new_sums, slots_of, take_all
from shell.compiled import hold
from skin.sync_counter import SYNC_OVERFLOW
from skin.walsh import walsh_matrix

#: Time in which the filter comes to rest: then sums err by a third of what is not worth a frame.
_REST_S: Final = 0.3
#: Most variance of the forecast of a coefficient at rest, in units of the noise's.
_VARIANCE_AT_REST: Final = 0.1
#: Offsets may lift full scale above what the first sum can tell, by up to this part of full scale.
_LIFT_RATIO: Final = 0.01
#: What is wrong with a frame, by how the receiver counts it.
_WRONG: Final = {
    AFTER_GAP: "has another count than the word before it and one",
    DUPLICATE: "came with the slot and count of the word before it",
    MALFORMED: "has words that are no step, set or check",
}


class SteppedFrames(ExpectedFrames):
    """The frames of a board that sends steps."""

    rest_s = _REST_S
    _patterns = (PATTERN_FULL, PATTERN_OFF, PATTERN_ZERO)

    def __init__(self, contract: Contract, node: NodeContract, report: NodeReport) -> None:
        super().__init__(contract, node, report)
        taxels, size = contract.layout.taxels, contract.phi.block_size
        #: As many SYNCs as a board needs for all sets, and for a check.
        told = max(form.groups for form in node.forms) + steps.KEEP_MIN + 2 * steps.LATE_SLOTS
        self.cycles = max(CYCLES, -(-told // contract.slots))
        self._top_n = taxels.count_max * taxels.newton_per_count
        self._tpdos = {tpdo.cob_id: tpdo for tpdo in node.tpdos}
        self._parts = np.flatnonzero(contract.parts.block == node.block)
        #: Sums of a picture in units, from those of the taxels in newtons.
        self._walsh = walsh_matrix(size) / contract.unit_n
        self._slots, self._state = slots_of(contract), new_sums(contract)
        self._known = hold((np.arange(contract.phi.blocks) == node.block, self._slots, contract.parts, self._state))
        #: What was wrong since the newest picture, by TPDO and kind; kind of the newest word of each TPDO.
        self._found: dict[tuple[int, int], str] = {}
        self._newest = dict.fromkeys(self._tpdos, steps.BAD)
        #: What the taxels read at full scale, and by how much more the first sum may be, units.
        self._full_n, self._lift = np.zeros(size), 0.0

    def hear(self, arrived: Frames) -> None:
        """Take all frames, with the echoes of those of the check."""
        for each in range(len(arrived)):
            one = arrived[each : each + 1]
            can_id, is_echo, data = int(one["can_id"][0]), bool(one["flags"][0] & ECHO), one["data"][0]
            if can_id == NMT_COB_ID and data[0] == NmtCommand.START:
                for part in self._parts.tolist():
                    forget(part, self._contract.parts, self._state)
                self._found.clear()
            elif can_id == SYNC_COB_ID and is_echo:
                self._take(one)
            elif can_id in self._tpdos and not is_echo:
                self._report.frames += 1
                self._compare(one, self._tpdos[can_id])

    def compare(self, came: Frames, picture: Picture, values: Values) -> None:
        """Tell what was wrong with the frames of a picture, and compare the sums that they have led to."""
        told = values.get((od.NODE_NOISE, 0), bytes(4))
        noise_n = float(np.frombuffer(told, "<f4")[0]) if len(told) == 4 else np.nan
        if not 0 <= noise_n < np.inf:
            self._differs(f"{picture.name}: the noise ({od.NODE_NOISE:04X}h) is no number of newtons: {told.hex(' ')}")
            return
        if len(syncs_of(came)) < SETTLING:
            self._differs(f"{picture.name}: the SYNC was not sent")
            return
        has_gaps = bool(self._found)
        for text in self._found.values():
            self._differs(f"{picture.name}: {text}")
        self._found.clear()
        for cob_id, tpdo in self._tpdos.items():
            first = self._parts[0] + tpdo.number - 1
            quiet_ns = int(came["time_ns"].max()) - int(self._state.newest_ns[first])
            missing = [group + 1 for group in range(64) if self._state.missing[first] >> group & 1]
            # Sets after a start are no news: the next check may be far.
            is_due = picture.is_step and quiet_ns > (steps.KEEP_MIN + steps.LATE_SLOTS) * self._slots.slot_ns
            if missing and has_gaps:
                return
            if missing:
                text = f"no set of group {missing[0]} came after the NMT start"
            elif is_due and self._newest[cob_id] != steps.CHECK:
                text = f"no check came within {steps.KEEP_MIN} slots after the newest step or set"
            else:
                continue
            self._differs(f"{picture.name}: TPDO {tpdo.number} ({cob_id:03X}h): {text}")
            return
        self._compare_sums(picture, noise_n, values)

    def _take(self, one: Frames) -> int:
        """Let the receiver take a frame; return how it counts the frame."""
        before = self._state.counts.copy()
        take_all(batch_of(one, self._node.bus, self._contract.parts), self._known)
        return int((self._state.counts - before).argmax())

    def _compare(self, one: Frames, tpdo: Tpdo) -> None:
        """Compare a frame; keep what is wrong with the first wrong one of a kind."""
        data, length, different = one["data"][0], int(one["length"][0]), int(self._state.different.sum())
        found, text = self._take(one), ""
        if length != tpdo.length:
            text = f"has {length} bytes, expected {tpdo.length}"
        elif not 1 <= data[0] <= SYNC_OVERFLOW:
            text = f"begins with {data[0]}, expected a slot from 1 to {SYNC_OVERFLOW}"
        elif found == LATE:
            since_ns = int(one["time_ns"][0]) - int(self._state.sync_ns[self._node.bus])
            now = int(self._state.sync_slot[self._node.bus]) + since_ns // self._slots.slot_ns
            text = f"names slot {data[0]}, expected {now % SYNC_OVERFLOW + 1}"
        elif self._state.different.sum() > different:
            text = "checks other sums than those that came"
        else:
            text = _WRONG.get(found, "")
        if text:
            self._found.setdefault((tpdo.number, found), f"TPDO {tpdo.number} ({tpdo.cob_id:03X}h) {text}")
        word = steps.read_word(data[1 : 1 + steps.WORD_BYTES])
        self._newest[tpdo.cob_id] = steps.kind_of(word, self._node.forms[tpdo.number - 1])[0]

    def _compare_sums(self, picture: Picture, noise_n: float, values: Values) -> None:
        """Compare the sums that the receiver holds; learn what the board reads at full scale."""
        size, unit_n = len(self._full_n), self._contract.unit_n
        held = np.concatenate(
            [self._state.known[part, : form.sums] for part, form in zip(self._parts, self._node.forms, strict=True)]
        )
        # A rounding, and what the filter leaves of the noise.
        slack = 1.0 + steps.NOISE_RATIO * noise_n * size**0.5 / unit_n
        if picture.values[od.TEST_PATTERN, 0] == bytes((PATTERN_FULL,)):
            self._learn(held, slack, picture.name)
            return
        shown_n = picture.counts[0] * (self._top_n / self._contract.layout.taxels.count_max)
        expected = self._walsh @ np.where(shown_n > 0, np.maximum(0, shown_n - self._top_n + self._full_n), 0)
        expected[0] = min(expected[0], steps.FIRST_MAX)
        expected[1:] = np.clip(expected[1:], steps.OTHER_MIN, steps.OTHER_MAX)
        if picture.is_step:  # what is not worth a frame is not sent
            quiet = float(np.frombuffer(values[od.SENDING, 1], "<f4")[0])
            per_sum = size * (steps.NOISE_RATIO**2 + steps.VARIANCE_RATIO * _VARIANCE_AT_REST) * (noise_n / unit_n) ** 2
            slack += (quiet * size * (1 + per_sum)) ** 0.5
        else:
            expected[0] = np.clip(held[0], expected[0], expected[0] + self._lift)
        for place in np.flatnonzero(np.abs(held - expected) > slack)[:1].tolist():
            told_mn, wanted_mn = 1e3 * unit_n * held[place], 1e3 * unit_n * expected[place]
            self._differs(f"{picture.name}: tells {told_mn:.2f} mN as sum {place + 1}, expected {wanted_mn:.2f} mN")

    def _learn(self, held: npt.NDArray[np.int64], slack: float, name: str) -> None:
        """Learn from the sums of full scale what the board reads there."""
        unit_n = self._contract.unit_n
        self._lift = _LIFT_RATIO * steps.FULL_SCALE * (held[0] == steps.FIRST_MAX)
        self._full_n = self._walsh.T @ held * (unit_n**2 / len(held))
        error_n = slack * unit_n
        wrong = np.flatnonzero((self._full_n < -error_n) | (self._full_n > self._top_n + error_n))
        if np.median(self._full_n) < self._top_n / 2:
            self._differs(f"{name}: half of the taxels read less than half of full scale")
        elif wrong.size:
            read_n = self._full_n[wrong[0]]
            self._differs(
                f"{name}: place {wrong[0]} reads {1e3 * read_n:.2f} mN, expected 0 to {1e3 * self._top_n:.2f}"
            )
