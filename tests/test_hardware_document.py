"""docs/hardware.md has the codes of causes as the code has them, and the commands that the planner prints."""

import re
from pathlib import Path

from bus.ip_link import ip_link
from health.causes import Cause
from skin.layout import Bus

ROOT = Path(__file__).parents[1]
DOCUMENT = (ROOT / "docs/hardware.md").read_text()


def test_faults_have_the_codes_of_causes() -> None:
    table = DOCUMENT.partition("| code | cause |")[2]
    codes = [code for row in table.splitlines() for code in re.findall("`([^`]*)`", row.partition(" | ")[0])]
    assert len(codes) >= 10
    assert set(codes) <= {cause.code for cause in Cause}


def test_the_interface_is_set_up_as_the_planner_prints() -> None:
    assert f"sudo {ip_link('can0', Bus(name='bus0', nodes=1))}\n" in DOCUMENT
