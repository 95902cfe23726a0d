"""``skin layout settings``: each value once, with the file or the default that it is of."""

import json
from pathlib import Path

import pytest

from bandwidth.layout_command import layout
from skin.layout import load_layout


def test_each_value_tells_where_it_comes_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "palm.toml"
    path.write_text('name = "palm"\n[taxels]\nrows = 16\ncolumns = 16\n[[bus]]\nname = "can0"\nnodes = 8\n')
    layout("settings", path, json_=True)
    found = {each["key"]: (each["value"], each["origin"]) for each in json.loads(capsys.readouterr().out)}
    assert found["name"] == ("palm", str(path))
    assert found["taxels.rows"] == (16, str(path))
    assert found["taxels.pitch_m"] == (load_layout().taxels.pitch_m, "default")
    assert found["measurement.sums"] == (128, "from other keys")
    assert found["sampling.rate_hz"] == (1000.0, "from other keys")
    assert found["bus[0].nodes"] == (8, str(path))
    assert found["bus[0].bitrate"] == (1_000_000, "default")


def test_the_table_has_a_line_for_each_value(capsys: pytest.CaptureFixture[str]) -> None:
    layout("settings")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["setting", "value", "from"]
    assert any(line.split() == ["sync.rate_hz", "200.0", "default.toml"] for line in lines)
