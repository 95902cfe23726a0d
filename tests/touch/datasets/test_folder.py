import hashlib
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError, RunError
from shell.output import alone
from touch.datasets.folder import DatasetFolder

ABOUT: dict[str, Any] = {
    "data_set": "acquisition",
    "made_by": "canskin 1",
    "settings": {"seed": 0, "objects": {"cup": {"spheres": 3}, "drill": {"spheres": 4}}},
}
FILES: dict[str, dict[str, Any]] = {"cup/true-00.npy": {"object": "cup"}}
VALUES = np.arange(6, dtype=np.float32).reshape(1, 2, 3)


def filled(folder: Path) -> DatasetFolder:
    made = DatasetFolder(folder, ABOUT)
    made.put(FILES, [VALUES])
    return made


def test_a_file_is_plain_npy_and_its_digest_that_of_sha256sum(tmp_path: Path) -> None:
    filled(tmp_path / "new" / "set")
    path = tmp_path / "new" / "set" / "cup" / "true-00.npy"
    np.testing.assert_array_equal(np.load(path, allow_pickle=False), VALUES)
    manifest = msgspec.json.decode((tmp_path / "new" / "set" / "manifest.json").read_bytes())
    entry = manifest["chunks"]["cup/true-00.npy"]
    assert entry == {"object": "cup", "shape": [1, 2, 3], "sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    assert manifest["settings"] == ABOUT["settings"]


def test_what_is_there_is_known_again(tmp_path: Path) -> None:
    filled(tmp_path)
    again = DatasetFolder(tmp_path, ABOUT)
    assert again.holds("cup/true-00.npy")
    assert not again.holds("cup/true-01.npy")


@pytest.mark.parametrize("harm", ["cut", "flipped", "missing"])
def test_a_damaged_file_does_not_count(tmp_path: Path, harm: str) -> None:
    filled(tmp_path)
    path = tmp_path / "cup" / "true-00.npy"
    content = path.read_bytes()
    if harm == "missing":
        path.unlink()
    else:
        path.write_bytes(content[:-1] if harm == "cut" else content[:-1] + bytes([content[-1] ^ 1]))
    assert not DatasetFolder(tmp_path, ABOUT).holds("cup/true-00.npy")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"data_set": "classification"}, "`.*data_set` is 'acquisition', there 'classification'"),
        ({"made_by": "canskin 2"}, "made_by` is 'canskin 1', there 'canskin 2'"),
        ({"settings": {**ABOUT["settings"], "seed": 1}}, "seed` is 0, there 1.: delete it or give another --out"),
        ({"settings": {**ABOUT["settings"], "dead": 0.5}}, r"dead` is not given, there 0\.5"),
        ({"settings": {"seed": 0, "objects": {"cup": {"spheres": 3}}}}, "objects.drill` is {.*}, there not given"),
        (
            {"settings": {"seed": 0, "objects": {"cup": {"spheres": 3}, "drill": {"spheres": 9}}}},
            "drill.spheres` is 4, there 9",
        ),
    ],
)
def test_other_settings_are_refused(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    filled(tmp_path)
    before = (tmp_path / "manifest.json").read_bytes()
    with pytest.raises(InputError, match=message):
        DatasetFolder(tmp_path, {**ABOUT, **change})
    assert (tmp_path / "manifest.json").read_bytes() == before


@pytest.mark.parametrize(
    "content", [b"", b"{", b"[]", b"{}", b'{"chunks": []}', b'{"chunks": {}}', b"\xff", 100_000 * b"["]
)
def test_manifests_that_are_none_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "manifest.json").write_bytes(content)
    with pytest.raises(InputError, match="delete"):
        DatasetFolder(tmp_path, ABOUT)


def test_a_setting_that_is_off_may_be_absent(tmp_path: Path) -> None:
    DatasetFolder(tmp_path, ABOUT)
    DatasetFolder(tmp_path, {**ABOUT, "settings": {**ABOUT["settings"], "dead": None}})


def test_folders_of_something_else_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("words")
    with pytest.raises(InputError, match=r"thesis\.tex and no data set"):
        DatasetFolder(tmp_path, ABOUT)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(InputError, match="cannot be used as a folder"):
        DatasetFolder(tmp_path / "thesis.tex", ABOUT)
    with pytest.raises(InputError, match="cannot be used as a folder"), alone(tmp_path / "thesis.tex"):
        pass


def test_a_file_that_cannot_be_written_ends_the_run(tmp_path: Path) -> None:
    folder = filled(tmp_path)
    (tmp_path / "drill").write_text("in the way")
    with pytest.raises(RunError, match="cannot be written"):
        folder.put({"drill/true-00.npy": {}}, [VALUES])
    assert DatasetFolder(tmp_path, ABOUT).holds("cup/true-00.npy")


def test_one_run_at_a_time(tmp_path: Path) -> None:
    with alone(tmp_path), pytest.raises(InputError, match="another run uses"), alone(tmp_path):
        pass
    with alone(tmp_path):
        assert not DatasetFolder(tmp_path, ABOUT).holds("cup/true-00.npy")
