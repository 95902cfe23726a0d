"""``skin config``: each value once, with the file, the hub, the environment, or the default that it is of."""

import json
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from demo.config_command import config
from shell.skin_options import SkinOptions, join
from skin.layout import load_layout


def printed(capsys: pytest.CaptureFixture[str]) -> dict[str, tuple[Any, str]]:
    return {each["key"]: (each["value"], each["origin"]) for each in json.loads(capsys.readouterr().out)}


def test_each_value_tells_where_it_comes_from(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("SKIN_CACHE", str(tmp_path))
    path = tmp_path / "palm.toml"
    path.write_text('name = "palm"\n[taxels]\nrows = 16\ncolumns = 16\n[[bus]]\nname = "can0"\nnodes = 8\n')
    config(of=SkinOptions(layout=path), json=True)
    found = printed(capsys)
    assert found["name"] == ("palm", str(path))
    assert found["taxels.rows"] == (16, str(path))
    assert found["taxels.pitch_m"] == (load_layout().taxels.pitch_m, "default")
    assert found["measurement.sums"] == (128, "from other keys")
    assert found["sampling.rate_hz"] == (1000.0, "from other keys")
    assert found["bus[0].nodes"] == (8, str(path))
    assert found["bus[0].bitrate"] == (1_000_000, "default")
    assert found["cache folder"] == (str(tmp_path), "$SKIN_CACHE")


def test_of_a_hub_every_key_of_the_layout_is_the_hubs(endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    with closing(join(load_layout(Path("fd")), "gateway", endpoint, hub=True)):
        config(of=SkinOptions(connect=endpoint), json=True)
    found = printed(capsys)
    assert found["bus[0].fd"] == (True, f"hub {endpoint}")
    assert found["sync.rate_hz"][1] == f"hub {endpoint}"


def test_the_table_has_a_line_for_each_value(capsys: pytest.CaptureFixture[str]) -> None:
    config()
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["setting", "value", "from"]
    assert any(line.split() == ["sync.rate_hz", "200.0", "default.toml"] for line in lines)
