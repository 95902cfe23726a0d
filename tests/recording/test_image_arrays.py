"""``skin replay --out images.npz``: the images of a recording and of a log are those of the live chain."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import can
import msgspec
import numpy as np
import pytest

from canskin.errors import InputError, RunError
from canskin.messages import IMAGE, MEASUREMENT, Image
from dbc.contract import Contract
from reconstructor.engine import Reconstructor
from reconstructor.imaging import make_imager
from reconstructor.options import SolverOptions
from reconstructor.service import ReconstructorService
from recording.replay_command import replay
from recording.sinks import McapSink
from tests.gateway.boards import small_stepped
from tests.layouts import buses, layout_toml
from tests.messages import measurement, stepped_measurement
from tests.recording.helpers import CYCLES, OFFSET_NS, SMALL, START_S, message, messages, write_log, write_run


def live_images(contract: Contract, sums: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """What the reconstructor would publish."""
    engine = Reconstructor(contract.phi, 16, 16, turns=contract.layout.sync.turns)
    sums_n = np.multiply(sums, np.float32(contract.layout.taxels.newton_per_count), dtype=np.float32)
    pairs = zip(sums_n, valid, strict=True)
    return np.stack([engine.solve(each, contract.phi.sums_of_blocks(kept)) for each, kept in pairs])


def loaded(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
    with np.load(path, allow_pickle=False) as made:
        assert set(made.files) == {"images", "valid", "time_ns", "cycle", "recording", "metadata"}
        return made["images"], made["valid"], made["time_ns"], msgspec.json.decode(str(made["metadata"]))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "images.npz"


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_a_log_gives_the_images_of_the_live_gateway(
    contract: Contract, sums: np.ndarray, layout_file: Path, tmp_path: Path, out: Path, suffix: str
) -> None:
    sent = messages(contract, sums)
    for each in sent:
        each.channel = {"left": "can0", "right": "can1"}[each.channel]
    path = write_log(tmp_path / f"can{suffix}", sent)
    replay(path, out=out, layout=layout_file)
    images, valid, time_ns, about = loaded(out)
    assert valid.all()
    np.testing.assert_array_equal(images, live_images(contract, sums, valid))
    np.testing.assert_allclose(np.diff(time_ns), 10_000_000, atol=2_000_000)
    if suffix == ".log":
        assert time_ns[0] == pytest.approx(START_S * 1e9, abs=1e4)
    assert about["source"] == path.name


def test_a_recording_without_frames_gives_the_images_of_its_measurements(
    contract: Contract, sums: np.ndarray, tmp_path: Path, out: Path
) -> None:
    phi = contract.phi
    valid = np.ones((CYCLES, phi.blocks), np.bool_)
    valid[3, 5] = False

    def recorded(name: str, fingerprint: str) -> Path:
        sink = McapSink(tmp_path / name, contract, 1, OFFSET_NS)
        for cycle, (each, kept) in enumerate(zip(sums, valid, strict=True)):
            about = {"sampled_mono_ns": cycle * 10_000_000, "fingerprint": fingerprint, "wall_offset_ns": OFFSET_NS}
            made = measurement(7 + cycle, sums=each.astype("<i4").tobytes(), valid=kept.tobytes(), **about)
            sink.message(MEASUREMENT, OFFSET_NS + cycle * 10_000_000, msgspec.msgpack.encode(made))
        sink.close()
        return tmp_path / name

    replay(recorded("page.mcap", phi.fingerprint), out=out)
    images, told, time_ns, _ = loaded(out)
    np.testing.assert_array_equal(told, valid)
    np.testing.assert_array_equal(images, live_images(contract, sums, valid))
    np.testing.assert_array_equal(time_ns, OFFSET_NS + np.arange(CYCLES) * 10_000_000)
    with pytest.raises(InputError, match="measured with Φ"):
        replay(recorded("other.mcap", "another"), out=tmp_path / "other.npz")


def test_only_what_the_gateway_would_use_counts(
    contract: Contract,
    sums: np.ndarray,
    layout_file: Path,
    tmp_path: Path,
    out: Path,
) -> None:
    """Lost, late, cut, foreign and doubled frames, and frames before the first SYNC. A SYNC that one bus lacks costs
    nothing, and a frame that comes after the next SYNC is used in the cycle that it names.
    """
    sent = messages(contract, sums)
    of_cycle = [sent[k : k + len(sent) // CYCLES] for k in range(0, len(sent), len(sent) // CYCLES)]
    first_tpdo = len(contract.layout.bus)

    def block_of(frame: Any) -> int:
        bus = [each.name for each in contract.layout.bus].index(frame.channel)
        row = contract.table.row_of[bus, frame.arbitration_id]
        return contract.nodes[contract.table.node[row]].block

    expected = np.ones((CYCLES, 16), np.bool_)
    lost = of_cycle[1].pop(first_tpdo)
    expected[1, block_of(lost)] = False
    late = of_cycle[3].pop(first_tpdo + 3)
    expected[3, block_of(late)] = False
    of_cycle[5].insert(first_tpdo + 1, message(of_cycle[5][0].timestamp, late.arbitration_id, late.data, late.channel))
    slow = of_cycle[9].pop()
    of_cycle[10].insert(first_tpdo, message(of_cycle[10][0].timestamp, slow.arbitration_id, slow.data, slow.channel))
    cut = of_cycle[5][first_tpdo + 5]
    of_cycle[5][first_tpdo + 5] = message(cut.timestamp, cut.arbitration_id, cut.data[:-1], cut.channel)
    expected[5, block_of(cut)] = False
    of_cycle[6].append(message(of_cycle[6][-1].timestamp, 0x7F0, b"\5", "left"))
    of_cycle[6].append(of_cycle[6][first_tpdo])  # the same again
    del of_cycle[8][1]  # the SYNC of the right bus
    before = [message(START_S - 1, each.arbitration_id, each.data, each.channel) for each in of_cycle[2][first_tpdo:]]
    path = write_log(tmp_path / "can.log", [*before, *(each for cycle in of_cycle for each in cycle)])

    replay(path, out=out, layout=layout_file)
    images, valid, _, _ = loaded(out)
    np.testing.assert_array_equal(valid, expected)
    kept = sums * expected[:, contract.phi.block_of_sum]
    np.testing.assert_array_equal(images, live_images(contract, kept, expected))


def test_channels_of_a_log_by_name(contract: Contract, sums: np.ndarray, layout_file: Path, tmp_path: Path) -> None:
    sent = messages(contract, sums)
    for each in sent:
        each.channel = {"left": "vcan7", "right": "vcan2"}[each.channel]
    path, out = write_log(tmp_path / "can.log", sent), tmp_path / "images.npz"
    replay(path, out=out, layout=layout_file, channel=["vcan7", "vcan2"])
    assert loaded(out)[1].all()
    with pytest.raises(InputError, match="expected a channel of can0"):
        replay(path, out=tmp_path / "other.npz", layout=layout_file, channel=["can0"])


def test_a_place_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path, layout_file: Path) -> None:
    (log := tmp_path / "can.log").touch()
    (there := tmp_path / "there.npz").write_bytes(b"precious")
    for out, says in ((there, "is there already"), (tmp_path / "images.npy", "ends in .mcap, or in .npz")):
        with pytest.raises(InputError, match=says):
            replay(log, out=out, layout=layout_file)
    assert there.read_bytes() == b"precious"


def without_sync_counter(sent: list[can.Message]) -> list[can.Message]:
    return [message(each.timestamp, 0x80, b"", each.channel) if each.arbitration_id == 0x80 else each for each in sent]


def without_frame_counter(sent: list[can.Message]) -> list[can.Message]:
    """Return frames as those of before: sums from the first byte on."""
    return [
        each
        if each.arbitration_id == 0x80
        else message(each.timestamp, each.arbitration_id, each.data[1:] + b"\0", each.channel)
        for each in sent
    ]


@pytest.mark.parametrize(
    ("aged", "says"),
    [(without_sync_counter, "holds no SYNC with a counter"), (without_frame_counter, "name no cycle of the log")],
)
def test_logs_of_before_the_counter_are_refused_with_one_line(
    contract: Contract,
    sums: np.ndarray,
    layout_file: Path,
    tmp_path: Path,
    out: Path,
    aged: Callable[[list[can.Message]], list[can.Message]],
    says: str,
) -> None:
    log = write_log(tmp_path / "old.log", aged(messages(contract, sums)))
    with pytest.raises(InputError, match=says) as refused:
        replay(log, out=out, layout=layout_file)
    assert str(refused.value).endswith("ogs of before the counter in each frame cannot be used any more")
    assert "\n" not in str(refused.value)
    assert not out.exists()


def test_what_cannot_be_used_is_named(
    contract: Contract, sums: np.ndarray, layout_file: Path, tmp_path: Path, out: Path
) -> None:
    sent = messages(contract, sums)
    log = write_log(tmp_path / "can.log", sent)
    no_sync = write_log(tmp_path / "no-sync.log", [each for each in sent if each.arbitration_id != 0x80])
    for arguments, says in (
        ({"source": tmp_path / "none.log"}, "no file"),
        ({"source": log, "channel": ["a", "b", "c"]}, "up to 2 channels"),
        ({"source": log, "solver": SolverOptions("best")}, "unknown solver 'best'"),
        ({"source": log, "solver": SolverOptions(basis="sim4")}, "unknown basis 'sim4': did you mean 'sym4'"),
        ({"source": log, "solver": SolverOptions("paper-contourlet", basis="sym4")}, "take another --solver"),
        ({"source": no_sync}, r"no SYNC with a counter \(COB-ID 80h, 1 byte\)"),
    ):
        with pytest.raises(InputError, match=says):
            replay(**arguments, out=out, layout=layout_file)
    assert not out.exists()


def test_a_log_of_another_layout_measures_nothing_and_fails(
    contract: Contract, sums: np.ndarray, tmp_path: Path, out: Path
) -> None:
    path, fd = write_log(tmp_path / "can.log", messages(contract, sums)), tmp_path / "fd.toml"
    fd.write_text(layout_toml(16, 16, **SMALL | {"bus": buses(8, 8, names=("left", "right"), fd=True)}))
    with pytest.raises(RunError, match="no measurement with a valid block"):
        replay(path, out=out, layout=fd)
    assert not out.exists()


def test_a_full_disk_leaves_no_half_file(
    contract: Contract, tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    run = write_run(tmp_path / "run.mcap", contract)
    monkeypatch.setattr("recording.image_arrays.np.savez", full)
    with pytest.raises(RunError, match="cannot be written: No space left"):
        replay(run, out=out)
    assert [*tmp_path.iterdir()] == [run]


@pytest.fixture
def stepped_run(tmp_path: Path) -> Path:
    """Return a recording of stepped measurements and of the images of a live reconstructor."""
    contract = small_stepped()
    shown: list[Image] = []
    live = SimpleNamespace(
        mailbox=lambda *_: None,
        publish=lambda topic, message: shown.append(message) if topic is IMAGE else None,
    )
    service = ReconstructorService(contract.layout, make_imager(contract.layout), live)
    sink = McapSink(tmp_path / "run.mcap", contract, 1, 1000)
    for cycle in range(1, 4):
        made = stepped_measurement(
            np.full(128, 1e-3 * cycle), layout=contract.layout, cycle=cycle, sampled_mono_ns=cycle * 10**6
        )
        named = msgspec.structs.replace(made, duty="reconstructor=gone")  # is not named in the replay
        sink.message(MEASUREMENT, cycle * 10**6, msgspec.msgpack.encode(named))
        if cycle != 2:  # the live reconstructor was busy
            service.take(made)
            sink.message(IMAGE, cycle * 10**6, msgspec.msgpack.encode(shown[-1]))
    sink.close()
    return tmp_path / "run.mcap"


def test_an_stepped_run_is_replayed_as_it_was_shown(
    stepped_run: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    replay(stepped_run, out=out)
    images, valid, time_ns, about = loaded(out)
    assert time_ns.tolist() == [1_001_000, 3_001_000]
    assert (images.shape, valid.shape, valid.all()) == ((2, 8, 16), (2, 4), True)
    assert images[1].mean() == pytest.approx(3e-3, rel=0.1)
    assert about["solver"] == "steps"
    assert "2 images, 2 of 2 equal to the recorded" in capsys.readouterr().err
    replay(stepped_run, out=out.with_name("other.npz"), solver=SolverOptions("variation"))
    images, _, _, about = loaded(out.with_name("other.npz"))
    assert (len(images), about["solver"]) == (3, "variation")
