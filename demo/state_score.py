"""What the demo tells of the two states of nodes: loads, labels, and the time of a switch."""

from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from canskin.messages import GatewayStatus, Label, Truth
from demo.report import StateFigures

#: Cycles with contact that wait for the measurement and the label of their cycle.
REMEMBERED = 1024
_NAMES = "recognition", "images"


@dataclass
class _Contact:
    """A cycle with contact and a named object: whether it is one of images, and gets the right label."""

    is_image: bool = False
    is_labelled: bool = False
    is_right: bool = False


class StateScore:
    """Collects figures by state.

    Attributes
    ----------
    switches : int
        Number of switches to images.
    switch_ms : list of float
        Time of each that a status told of.
    """

    def __init__(self) -> None:
        self.switches = 0
        self.switch_ms: list[float] = []
        self._loads: defaultdict[str, list[list[float]]] = defaultdict(list)
        self._contacts: dict[int, _Contact] = {}
        #: By state: contacts, those with a label, those with the right one.
        self._counts = np.zeros((len(_NAMES), 3), np.int64)
        self._last = ""

    def take_gateway(self, status: GatewayStatus) -> None:
        """Take a status; a load is that of a state if the status before was of the same."""
        if status.state and status.state == self._last:
            self._loads[status.state].append([bus.load_ratio for bus in status.buses])
        self._last = status.state
        if status.switches > self.switches:
            self.switches = status.switches
            self.switch_ms.append(status.switch_s * 1e3)

    def take_contact(self, truth: Truth) -> None:
        """Count a cycle with contact and a named object, before what else comes of it."""
        self._contacts[truth.sampled_mono_ns] = _Contact()
        if len(self._contacts) > REMEMBERED:
            _count(self._counts, self._contacts.pop(next(iter(self._contacts))))

    def take_image_cycle(self, truth: Truth) -> None:
        """Note that a cycle is one of images: its measurement has come."""
        if (contact := self._contacts.get(truth.sampled_mono_ns)) is not None:
            contact.is_image = True

    def take_label(self, label: Label, truth: Truth) -> None:
        """Note the label of a cycle."""
        if (contact := self._contacts.get(truth.sampled_mono_ns)) is not None:
            contact.is_labelled, contact.is_right = True, label.label == truth.label

    def figures(self) -> dict[str, StateFigures]:
        """Return the figures of the states that came; empty for nodes without states."""
        counts = self._counts.copy()
        for contact in self._contacts.values():
            _count(counts, contact)
        return {
            name: StateFigures(
                bus_load=np.mean(loads, axis=0).round(4).tolist() if (loads := self._loads.get(name)) else None,
                contacts=int(contacts),
                label_accuracy=float(right / contacts) if labelled else None,
            )
            for name, (contacts, labelled, right) in zip(_NAMES, counts, strict=True)
            if self._loads
        }


def _count(counts: npt.NDArray[np.int64], contact: _Contact) -> None:
    counts[int(contact.is_image)] += (1, contact.is_labelled, contact.is_right)
