"""The code of docs/integrations.md."""

import re
from pathlib import Path

import pytest

pytest.importorskip("lerobot", reason="NOT TESTED: the code of docs/integrations.md, for want of lerobot")

from tests.client.lerobot_camera_canskin.conftest import LiveChain
from tests.documents import block

RECORD, READ = block("docs/integrations.md", "CanskinCamera("), block("docs/integrations.md", "forces(")


def test_touch_of_a_running_skin_is_recorded_and_read(
    live_chain: LiveChain, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    live_chain.start()
    config = f'endpoint="{live_chain.endpoint}", timeout_s=20.0, max_age_ms=20_000'
    record = RECORD.replace("Config(", f"Config({config}, ").replace("async_read()", "async_read(20_000)")
    exec(record.replace("range(90)", "range(12)").replace("1 / 30", "0"), {})  # noqa: S102 - our own page
    exec(READ, {})  # noqa: S102
    said = capsys.readouterr().out
    assert re.match(r"\d+ cycles lost\ntensor\(15\.\) tensor\(\[1\d{18}", said)
    assert "(4, 4, 4) " in said
