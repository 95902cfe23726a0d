"""docs/hardware.md quotes messages as the code has them, and the commands that the planner prints."""

import re
from pathlib import Path

from bus.ip_link import ip_link
from skin.layout import Bus

ROOT = Path(__file__).parents[1]
DOCUMENT = (ROOT / "docs/hardware.md").read_text()
#: Folders whose messages a user of boards sees.
FOLDERS = ("bus", "gateway", "health", "shell")


def test_messages_of_faults_are_those_of_the_code() -> None:
    code = "\n".join(path.read_text() for folder in FOLDERS for path in (ROOT / folder).glob("*.py"))
    joined = re.sub(r"\{[^{}\n]*\}", "…", re.sub(r'["\']\n\s*f?["\']', "", code))
    table = DOCUMENT.partition("| you see |")[2]
    quoted = [text for row in table.splitlines() for text in re.findall("`([^`]*)`", row.partition(" | ")[0])]
    assert len(quoted) >= 10
    assert [text for text in quoted if text.rstrip("…") not in joined] == []


def test_the_interface_is_set_up_as_the_planner_prints() -> None:
    assert f"sudo {ip_link('can0', Bus(name='bus0', nodes=1))}\n" in DOCUMENT
