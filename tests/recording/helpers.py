"""A recorded run of four cycles, and the messages of a recording."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canskin.messages import Topic
from skin.mcap_file import read_entries

COUNT = 4
#: The wall clock is set by this time during cycle 2.
SET_NS = 7_000


def pixels(cycle: int) -> np.ndarray:
    return np.arange(256, dtype="<f4").reshape(16, 16) * cycle * 1e-5


def messages(path: Path, topic: Topic) -> list[Any]:
    decode = topic.decoder()
    return [decode(entry.data) for entry in read_entries(path, pytest.fail) if entry.topic == topic.name]
