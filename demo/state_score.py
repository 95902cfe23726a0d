"""What the demo tells of the two states of nodes: loads, labels, and the time of a switch."""

from collections import defaultdict, deque

import numpy as np

from canskin.messages import GatewayStatus, Label, Measurement
from demo.report import StateFigures

#: Cycles of images that are remembered, to tell in which state a label was made.
REMEMBERED = 1024
_NAMES = "recognition", "images"


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
        self._labels: defaultdict[str, list[bool]] = defaultdict(list)
        self._images: deque[int] = deque(maxlen=REMEMBERED)
        self._last = ""

    def take_gateway(self, status: GatewayStatus) -> None:
        """Take a status; a load is that of a state if the status before was of the same."""
        if status.state and status.state == self._last:
            self._loads[status.state].append([bus.load_ratio for bus in status.buses])
        self._last = status.state
        if status.switches > self.switches:
            self.switches = status.switches
            self.switch_ms.append(status.switch_s * 1e3)

    def take_measurement(self, measurement: Measurement) -> None:
        """Remember a cycle of images."""
        self._images.append(measurement.cycle)

    def count_label(self, label: Label, *, is_right: bool) -> None:
        """Count a label of a cycle with contact."""
        self._labels[_NAMES[label.cycle in self._images]].append(is_right)

    def figures(self) -> dict[str, StateFigures]:
        """Return the figures of the states that came; empty for nodes without states."""
        return {
            name: StateFigures(
                bus_load=np.mean(loads, axis=0).round(4).tolist() if (loads := self._loads.get(name)) else None,
                label_accuracy=float(np.mean(labels)) if (labels := self._labels.get(name)) else None,
            )
            for name in _NAMES
            if self._loads
        }
