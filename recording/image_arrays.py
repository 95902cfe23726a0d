"""The images of a replay as arrays in one ``.npz``."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from canskin.errors import RunError, reasoned
from canskin.messages import Image, Measurement, Topic
from recording.recorded_tables import stack
from shell.output import replacing
from skin.layout import Layout
from skin.wall_times import Clocks, WallTimes


class ImageArrays:
    """Keeps the images that a replay publishes, and writes them to a file.

    Parameters
    ----------
    offset_ns : int
        Wall clock minus the clock of the measurements, where these do not tell.
    """

    def __init__(self, offset_ns: int) -> None:
        self._wall = WallTimes(offset_ns)
        self._images: list[Image] = []
        self._time_ns: list[int] = []

    def publish(self, _topic: Topic, message: msgspec.Struct) -> None:
        """Keep an image; its measurement, which came before, tells its time on the wall clock."""
        if isinstance(message, Measurement):
            self._wall.take(Clocks(message.sampled_mono_ns, message.wall_offset_ns or None))
        elif isinstance(message, Image):
            self._images.append(message)
            self._time_ns += self._wall.times_ns([message.sampled_mono_ns]).tolist()

    def save(self, path: Path, layout: Layout, recording: str, about: Mapping[str, Any]) -> None:
        """Write the file: what it is `about` beside the skin, and the images.

        ``images`` float32 (n, rows, columns) in newtons, ``valid`` bool (n, blocks), ``time_ns`` and ``cycle`` int64
        (n,), the name of the ``recording``, ``metadata`` JSON.

        Raises
        ------
        RunError
            If the file cannot be written.
        """
        shape = layout.taxels.rows, layout.taxels.columns
        metadata = {"layout": layout.name, "fingerprint": layout.phi().fingerprint, **about}
        with reasoned(RunError, f"{path}: the images cannot be written"), replacing(path) as file:
            np.savez(
                file,
                images=stack([each.pixels for each in self._images], "<f4", shape),
                valid=stack([each.valid for each in self._images], np.bool_, (layout.blocks,)),
                time_ns=np.array(self._time_ns, np.int64),
                cycle=np.array([each.cycle for each in self._images], np.int64),
                recording=np.array(recording),
                metadata=np.array(msgspec.json.encode(metadata).decode()),
            )
