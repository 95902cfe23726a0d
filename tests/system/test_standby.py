"""Two workers and several skins: no skin is without images for long when one of the workers stops."""

from pathlib import Path

import pytest

from tests.processes import Processes, free_endpoint
from tests.system.many_skins import disturb


@pytest.mark.slow
def test_a_worker_that_is_killed_or_stopped_is_replaced_and_no_cycle_has_two_images(tmp_path: Path) -> None:
    with Processes(tmp_path) as processes:
        seen = disturb(processes, free_endpoint(), ["palm", "arm"], [("stop", 0), ("kill", 1)])
        changes = processes.log("gateways").read_text().count(" publishes: ")
    assert seen["doubled"] == 0
    assert changes > 0
    assert seen["images"] > 100
