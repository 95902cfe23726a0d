"""A long run: memory and descriptors of the gateway's loop stay as they are, and every frame is counted."""

import os
from pathlib import Path

import numpy as np
import pytest

from dbc.contract import Contract
from tests.layouts import buses, small_layout
from tests.world import World

#: Frames with sums of a run, for example 10000000.
FRAMES = int(os.environ.get("SKIN_SOAK", "30000"))
#: Looks at memory in a run; the first third is not judged: caches fill.
LOOKS = 30
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
#: Growth of a run that is noise of the allocator.
GROWTH_BYTES = 4 << 20


def resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_BYTES


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def forget(world: World) -> None:
    """Drop what the test's world keeps, and the gateway does not."""
    world.measured.clear()
    world._wrong.clear()
    world.sampler._true.clear()
    for wire in world.wires:
        wire.log.clear()


@pytest.mark.slow
def test_memory_and_descriptors_stay_as_they_are() -> None:
    world = World(Contract.from_layout(small_layout(64, 64, name="soak", sync={"rate_hz": 20.0}, bus=buses(64, 64))))
    world.until_whole(10.0)
    opened, memory_bytes = descriptors(), []
    for look in range(LOOKS):
        while world.status().frames.accepted < FRAMES * (look + 1) // LOOKS:
            came = world.run(1.0)
            assert not any(world.wrong_blocks(each) for each in came)
            forget(world)
        memory_bytes.append(resident_bytes())
    judged = memory_bytes[LOOKS // 3 :]
    growth_bytes = np.polyfit(np.arange(len(judged)), judged, 1)[0] * len(judged)
    counts = world.status().frames
    print(f"{counts.accepted} frames: memory grew by {growth_bytes / 1024:.0f} KiB, {descriptors()} descriptors")
    assert growth_bytes < GROWTH_BYTES
    assert descriptors() == opened
    assert (counts.late, counts.duplicate, counts.malformed, counts.missing) == (0, 0, 0, 0)
    assert world.status().cycles_complete >= world.status().cycles - 1
