"""Recordings as arrays: every format holds the same."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError, RunError
from canskin.messages import IMAGE, LABEL, Topic
from dbc.contract import Contract
from recording.export_command import Format, export
from recording.recorded_tables import read_tables
from recording.sinks import McapSink
from skin.layout import load_layout
from tests import messages as make
from tests.layouts import tube_layout
from tests.recording.helpers import COUNT, OFFSET_NS, SET_NS, pixels
from touch.sources import recording


def test_npz(run: Path, contract: Contract) -> None:
    export(run)
    with np.load(run.with_suffix(".npz")) as made:
        np.testing.assert_array_equal(made["images_pixels"], [pixels(cycle) for cycle in range(1, COUNT + 1)])
        times_ns = [OFFSET_NS + 10 * cycle + SET_NS * (cycle > 2) for cycle in range(1, COUNT + 1)]
        for table in ("measurements", "images", "labels"):
            assert made[f"{table}_time_ns"].tolist() == times_ns
            assert made[f"{table}_sampled_error_ns"].tolist() == [1, 2, 3, 4]
        assert made["contacts_sampled_error_ns"].tolist() == [2]
        assert made["contacts_time_ns"].tolist() == times_ns[1:2]
        measured = made["images_valid"][:, made["taxels_block"]].reshape(made["images_pixels"].shape)
        assert measured.all(axis=(1, 2)).tolist() == [False, True, True, True]
        np.testing.assert_array_equal(made["taxels_block"], contract.phi.block_of_taxel)
        assert made["images_valid"].all(axis=1).tolist() == [False, True, True, True]
        np.testing.assert_array_equal(made["measurements_sums"][:, 5], [1, 2, 3, 4])
        assert made["measurements_usable"].shape == made["measurements_sums"].shape
        assert made["measurements_usable"][:, 5].tolist() == [True, False, True, True]
        assert (made["contacts_cycle"].tolist(), made["contacts_force_n"].tolist()) == ([2], [0.25])
        assert [made[f"contacts_{name}"].tolist() for name in ("x_m", "y_m", "z_m")] == [[0.01], [0.02], [0.03]]
        assert [made[f"contacts_{name}"].tolist() for name in ("nx", "ny", "nz")] == [[0.0], [0.6], [-0.8]]
        assert made["labels_label"].tolist() == ["cup"] * COUNT
        about = msgspec.json.decode(str(made["metadata"]))
    assert about["skin"] == "small"
    assert 'name = "small"' in about["layout"]


def test_a_skin_that_is_no_grid_says_where_its_taxels_lie(out: Path) -> None:
    layout = tube_layout()
    surface, forces_n = layout.taxels.surface, np.arange(96, dtype="<f4") * 1e-4
    sink = McapSink(out, Contract.from_layout(layout), 1, OFFSET_NS)
    image = make.image(1, pixels=forces_n.tobytes(), valid=b"\1" * 3)
    sink.message(IMAGE, 1, msgspec.msgpack.encode(image))
    sink.close()
    assert load_layout(out) == layout
    export(out)
    with np.load(out.with_suffix(".npz")) as made:
        np.testing.assert_array_equal(made["images_pixels"], forces_n.reshape(1, 1, 96))
        places_m = np.stack([made[f"taxels_{axis}_m"] for axis in "xyz"], axis=1)
        normals = np.stack([made[f"taxels_n{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_array_equal(places_m, surface.positions_m)
    np.testing.assert_array_equal(normals, surface.normals)


@pytest.mark.parametrize(
    ("to", "name"),
    [("npz", "run.parquet"), ("npz", "a.mcap"), ("parquet", "run.csv"), ("ros2", "bag.mcap"), ("video", "run.npz")],
)
def test_a_file_is_what_its_suffix_says(run: Path, tmp_path: Path, to: Format, name: str) -> None:
    with pytest.raises(InputError, match=rf"--to {to} writes no '\{Path(name).suffix}': expected another --to"):
        export(run, to=to, out=tmp_path / name)


@pytest.mark.parametrize(("to", "made"), [("npz", "new.npz"), ("parquet", "new-images.parquet")])
def test_a_name_without_a_suffix_gets_that_of_its_kind(run: Path, tmp_path: Path, to: Format, made: str) -> None:
    if to == "parquet":
        pytest.importorskip("pyarrow")
    export(run, to=to, out=tmp_path / "new")
    assert (tmp_path / made).is_file()


def test_nothing_is_written_if_a_table_is_there_already(run: Path, tmp_path: Path) -> None:
    (tmp_path / "out-labels.parquet").touch()
    with pytest.raises(InputError, match="is there already"):
        export(run, to="parquet", out=tmp_path / "out.parquet")
    assert not list(tmp_path.glob("out-[!l]*"))


def test_the_images_of_a_run_can_be_played(run: Path) -> None:
    played = recording(run, 16, 16, force_max_n=0.02)
    assert (played.frames, played.full_scale) == (COUNT, 0.02)
    np.testing.assert_allclose(played.frame(3).force_n, pixels(4), rtol=1e-6)
    with pytest.raises(InputError, match="has no array 'true': expected one of image"):
        recording(run, 16, 16, arrays="true")
    log = run.with_suffix(".log")
    log.touch()
    with pytest.raises(InputError, match="make its images with 'skin replay"):
        recording(log, 16, 16)


def test_a_run_is_a_layout(run: Path, contract: Contract) -> None:
    assert load_layout(run) == contract.layout


def test_a_message_of_another_version_is_refused_in_one_line(contract: Contract, tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    sink = McapSink(path, contract, 1, 0)
    sink.message(LABEL, 1, msgspec.msgpack.encode({"cycle": 1, "sync_counter": 1, "sync_mono_ns": 1}))
    sink.close()
    with pytest.raises(InputError, match=r"'label' cannot be decoded, it is of another version.*sampled_mono_ns"):
        read_tables(path, contract.layout, pytest.fail)


@pytest.mark.parametrize(("topic", "message"), [(LABEL, make.label(2**63)), (IMAGE, make.image(1, pixels=b"1234"))])
def test_messages_that_no_array_of_the_layout_holds_are_refused(
    contract: Contract, out: Path, topic: Topic, message: msgspec.Struct
) -> None:
    sink = McapSink(out, contract, 1, 0)
    sink.message(topic, 1, msgspec.msgpack.encode(message))
    sink.close()
    with pytest.raises(InputError, match="its messages do not fit the layout 'small'"):
        read_tables(out, contract.layout, pytest.fail)


@pytest.mark.parametrize(
    ("to", "says"),
    [
        ("npz", "skin replay --out"),
        ("ros2", "holds no messages"),
        ("video", "holds no images"),
        ("rerun", "holds no images"),
        ("foxglove", "holds no images"),
    ],
)
def test_frames_alone_leave_no_file(contract: Contract, out: Path, to: Any, says: str) -> None:
    McapSink(out, contract, 1, OFFSET_NS).close()
    with pytest.raises(RunError, match=says):
        export(out, to=to)
    assert list(out.parent.iterdir()) == [out]
