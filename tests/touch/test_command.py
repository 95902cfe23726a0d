import msgspec
import pytest

from touch.command import objects
from touch.objects import CATALOGUE


def test_json_lists_the_catalogue(capsys: pytest.CaptureFixture[str]) -> None:
    objects(json=True)
    rows = msgspec.json.decode(capsys.readouterr().out)
    assert [row["name"] for row in rows] == list(CATALOGUE)
    golf = rows[0]
    assert (golf["length_m"], golf["spheres"], golf["contact_taxels"]) == (0.04267, 1, 76)
    assert all(0.0095 < row["peak_force_n"] <= 0.00999 for row in rows)


def test_the_table_names_every_object(capsys: pytest.CaptureFixture[str]) -> None:
    objects()
    out = capsys.readouterr().out
    assert all(name in out for name in CATALOGUE)
