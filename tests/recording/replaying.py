"""Replays a file in a process of its own: ``python -m tests.recording.replaying SOURCE OUT OFFSET_NS [LAYOUT]``."""

import sys
from pathlib import Path

from canskin.fabric import Exchange
from canskin.messages import Label, Measurement
from classifier.service import ClassifierService
from dbc.contract import Contract
from reconstructor.imaging import make_imager
from recording.replaying import Replay
from recording.run_steps import steps_of
from recording.sinks import McapSink
from shell.service import StopSignal
from skin.layout import load_layout


class Silent(ClassifierService):
    """A classifier without a model."""

    def __init__(self, _exchange: Exchange) -> None:
        """It needs nothing."""

    def label(self, measurement: Measurement) -> Label | None:
        return None


def replay(source: Path, out: Path, offset_ns: int, layout: Path) -> Replay:
    """Replay a recording or a log into a new recording."""
    skin = load_layout(layout)
    contract = Contract.from_layout(skin)
    solver = make_imager(skin)
    sink = McapSink(out, contract, 1, offset_ns)
    replayed = Replay(skin, solver, Silent, sink=sink, offset_ns=offset_ns)
    replayed.run(steps_of(source, contract), StopSignal(), float("inf"))
    sink.close()
    return replayed


if __name__ == "__main__":
    played, wanted, offset, of_layout = sys.argv[1:]
    for line in replay(Path(played), Path(wanted), int(offset), Path(of_layout)).report.lines():
        print(line)
