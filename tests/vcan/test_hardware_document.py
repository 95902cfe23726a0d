"""The commands of docs/hardware.md run as they stand, from top to bottom, on a virtual interface of a real kernel."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Final

from tests.documents import ROOT, blocks

#: All blocks together: a guest kernel on a shared processor takes minutes to start twenty commands.
PATIENCE_S: Final = 840.0
#: Stops at the first command that fails; ends what runs in the background. The test is root, so sudo is not needed.
BEGIN: Final = """
set -eu
sudo() { "$@"; }
trap 'ip link delete can0; kill $(jobs -p); wait' EXIT
set -x
"""


def test_every_block_that_needs_no_hardware_runs(tmp_path: Path) -> None:
    own = Path(__file__).relative_to(ROOT).as_posix()
    here = [each.code for each in blocks("docs/hardware.md", "sh") if each.mark == own]
    assert len(here) >= 6
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    log = tmp_path / "log"
    with log.open("w") as said:
        command = [shutil.which("bash") or "bash", "-c", BEGIN + "".join(here)]
        running = subprocess.Popen(
            command,
            cwd=tmp_path,
            env={**os.environ, "PATH": path},
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            start_new_session=True,
        )
        try:
            status = running.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            os.killpg(running.pid, signal.SIGKILL)
            status = running.wait()
    print(log.read_text())
    assert status == 0
    assert "keeps the contract" in log.read_text()
