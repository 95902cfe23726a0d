"""Makes the pictures of ``skin monitor`` from a real run."""

import io
import os
import re
import signal
import tempfile
from contextlib import closing
from pathlib import Path
from typing import Final

from rich.console import Console

from canskin.session import peers_at
from health.feed import Watched
from shell.output import write_file
from shell.skin_options import SkinOptions, knows_layout
from tests.processes import PATIENCE_S, Processes, free_endpoint
from views.monitor.command import SERVICE, TOPICS
from views.monitor.drawing import screen

#: Between two looks at the state, seconds.
LOOK_S: Final = 0.1
#: Services that tell what they make: gateway, nodes, reconstructor, classifier.
RATES: Final = 4


def monitor(path: Path, size: tuple[int, int]) -> None:
    """Draw what ``skin monitor`` shows of the forearm while its classifier hangs."""
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory() as folder, Processes(Path(folder)) as processes:
        figure, touch = str(Path(folder) / "demo.png"), ("--layout", "forearm", "--objects", "golf-ball")
        processes.skin(
            "demo", "demo", *touch, "--seconds", "300", "--listen", endpoint, "--no-view", "--figure", figure
        )
        processes.until(lambda: "processes:" in processes.log("demo").read_text(), "the demo")
        peers_at(endpoint, PATIENCE_S, lambda peers: any(map(knows_layout, peers)))
        of = SkinOptions(connect=endpoint)
        skin = of.find()
        with closing(of.join(skin, SERVICE)) as fabric:
            watched = Watched(skin, fabric, TOPICS, polled=True)

            def has_rates() -> bool:
                told = [each.made_per_s for each in watched.snapshot().services.values()]
                return len(told) - told.count(None) >= RATES

            processes.until(has_rates, "what the services make", LOOK_S)
            classifier = int(re.findall(r"classifier (\d+)", processes.log("demo").read_text())[-1])
            os.kill(classifier, signal.SIGSTOP)
            processes.until(lambda: bool(watched.snapshot().notices), "its notice", LOOK_S)
            lines = screen(watched.snapshot(), "a", size)[0]
            os.kill(classifier, signal.SIGCONT)
    console = Console(record=True, width=size[0], file=io.StringIO(), force_terminal=True)
    for line in lines:
        console.print(line, soft_wrap=True)
    svg = console.export_svg(title="skin monitor")
    # Without fonts of another host: a browser takes its own.
    write_file(path, re.sub(r"@font-face \{.*?\}", "", svg, flags=re.DOTALL))
