"""Gains and offsets of taxels written to the nodes (2010h, 2011h), which store them (1010h)."""

import struct
from collections.abc import Generator, Mapping, Sequence
from typing import Final

import numpy as np

from calibration.windows import Floats
from canskin.errors import InputError
from dbc import indices as od
from dbc.contract import Contract, NodeContract
from gateway.nmt_master import NmtMaster
from gateway.sdo import SdoDialogue, Transfer, Write
from skin.calibration_file import StoredCalibration
from skin.ranges import ranges_text

#: Most nodes of a bus that are written to at the same time.
MOST_AT_ONCE: Final = 4
#: Attempts to write to a node.
ATTEMPTS: Final = 3
#: Time after which a node that cannot be written to is given up: it is not there, or not proven.
UNREACHED_S: Final = 20.0


class NodeWriting:
    """Writes to all nodes of a skin, and says which have failed.

    Parameters
    ----------
    masters : mapping of int to NmtMaster
        By number of the bus. Their SDO dialogues are used, one at a time with a node.
    gains, offsets : array, shape (n,), or None
        Row-major: the factor that a node applies to a taxel's counts, and what the node adds then, whole counts that
        fit int16; None leaves what the nodes have.
    """

    def __init__(
        self,
        contract: Contract,
        masters: Mapping[int, NmtMaster],
        gains: Floats | None,
        offsets: Floats | None,
        now_s: float,
    ) -> None:
        self._masters = masters
        self._nodes = {number: contract.on_bus(number) for number in masters}
        self._chains = contract.phi.taxels_of_blocks
        self._gains, self._offsets = gains, offsets
        self._names = {number: contract.layout.bus[number].name for number in masters}
        self._waiting = {number: [(node, 0) for node in nodes] for number, nodes in self._nodes.items()}
        self._open: dict[int, list[tuple[NodeContract, int, SdoDialogue]]] = {number: [] for number in masters}
        self._failed: dict[int, list[int]] = {number: [] for number in masters}
        self._why = ""
        self._until_s = dict.fromkeys(masters, now_s + UNREACHED_S)

    @property
    def done(self) -> bool:
        """Whether every node has been written to, or given up."""
        return not any(self._waiting.values()) and not any(self._open.values())

    @property
    def is_complete(self) -> bool:
        """Whether no node was given up."""
        return not any(self._failed.values())

    def tick(self, now_s: float) -> None:
        """Begin what can begin, and look at what has ended."""
        for number, master in self._masters.items():
            self._end(number, now_s)
            waiting, mine = self._waiting[number], self._open[number]
            for node, tried in waiting.copy():
                if len(mine) >= MOST_AT_ONCE:
                    break
                dialogue = master.ask(node.node_id, self._steps(node), now_s)
                if dialogue is not None:
                    waiting.remove((node, tried))
                    mine.append((node, tried + 1, dialogue))
            if waiting and not mine and now_s > self._until_s[number]:
                self._failed[number] += [node.node_id for node, _ in waiting]
                waiting.clear()

    def text(self) -> str:
        """Return the result in words."""
        count = sum(map(len, self._nodes.values())) - sum(map(len, self._failed.values()))
        lost = [
            f"{self._names[number]} node{'s' * (len(nodes) > 1)} {ranges_text(sorted(nodes))}"
            for number, nodes in self._failed.items()
            if nodes
        ]
        said = f"{count} nodes have written and stored it"
        why = f" ({self._why})" if self._why else ""
        return f"{said}; not {', '.join(lost)}{why}" if lost else said

    def _end(self, number: int, now_s: float) -> None:
        still = []
        for node, tried, dialogue in self._open[number]:
            if not dialogue.done and self._masters[number].nodes[node.node_id].errand is dialogue:
                still.append((node, tried, dialogue))
                continue
            self._until_s[number] = now_s + UNREACHED_S
            if dialogue.done and dialogue.error is None:
                continue
            self._why = str(dialogue.error or "the node left the bus")
            if tried < ATTEMPTS:
                self._waiting[number].append((node, tried))
            else:
                self._failed[number].append(node.node_id)
                # It may have a part of what was written, or none: what is found next is no value that somebody accepts.
                self._masters[number].nodes[node.node_id].known.doubt()
        self._open[number] = still

    def _steps(self, node: NodeContract) -> Generator[Transfer, bytes, None]:
        self._masters[node.bus].nodes[node.node_id].known.write()
        for place in range(node.blocks):
            chain: Sequence[int] = self._chains[node.block + place].tolist()
            for index, values, form in ((od.GAIN, self._gains, "<f"), (od.OFFSET, self._offsets, "<h")):
                if values is None:
                    continue
                for subindex, taxel in enumerate(chain, 1):
                    if taxel >= len(values):  # an empty place
                        continue
                    value = float(values[taxel]) if form == "<f" else int(values[taxel])
                    yield Write(od.of_block(index, place), subindex, struct.pack(form, value))
        yield Write(od.STORE, 1, od.SIGNATURE_SAVE.to_bytes(4, "little"))


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
