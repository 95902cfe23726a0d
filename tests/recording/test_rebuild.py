"""``skin rebuild``: the images of a recording and of a log are those of the live chain."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, get_args

import can
import msgspec
import numpy as np
import pytest

from canskin.errors import InputError, LayoutError, RunError
from canskin.messages import IMAGE, MEASUREMENT, Image
from dbc.contract import Contract
from dbc.packing import packing
from nodes.electronics import Electronics
from nodes.sampler import Sampler
from reconstructor.array_api import NUMPY
from reconstructor.engine import Reconstructor
from reconstructor.imaging import CycleImager, load_gains, make_imager
from reconstructor.options import SolverOptions
from reconstructor.service import ReconstructorService
from reconstructor.settings import Device
from recording import rebuild_command, sinks
from recording.cycles import measure_forces
from recording.rebuild_command import rebuild
from recording.sinks import McapSink
from skin.calibration_file import encoded, new_calibration
from skin.layout import layout_text, load_layout
from skin.measured_sums import MeasuredSums
from tests.gateway.boards import small_stepped
from tests.layouts import buses, layout_toml, small_layout
from tests.messages import measurement, stepped_measurement
from tests.recording.helpers import CYCLES, OFFSET_NS, SMALL, START_S, message, messages, write_log
from touch.sources import recording


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


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".csv"])
def test_a_recording_gives_the_images_of_live_nodes(
    contract: Contract, force_n: np.ndarray, layout_file: Path, tmp_path: Path, out: Path, suffix: str
) -> None:
    path = tmp_path / f"mat{suffix}"
    counts = np.rint(force_n / 0.02 * 4095).astype(np.uint16)
    if suffix == ".csv":
        np.savetxt(path, counts.reshape(CYCLES, -1), fmt="%d", delimiter=",")
    elif suffix == ".npy":
        np.save(path, counts)
    else:
        np.savez(path, first=0 * counts + 1, mat=counts)
    rebuild(path, out=out, layout=layout_file, full_scale=4095, array=["mat"] if suffix == ".npz" else None)
    images, valid, time_ns, about = loaded(out)

    source = recording(path, 16, 16, full_scale=4095, arrays=["mat"] if suffix == ".npz" else None)
    sampler = Sampler(contract.phi, source, Electronics(contract.layout.taxels, noise_n=0.0))
    sums = np.stack([sampler.sample(k + 1, k * 10_000_000) for k in range(CYCLES)])
    np.testing.assert_array_equal(images, live_images(contract, sums, np.ones((CYCLES, 16), np.bool_)))
    assert images.dtype == np.float32
    assert images.shape == (CYCLES, 16, 16)
    assert images.max() > 0.006
    assert valid.shape == (CYCLES, 16)
    assert valid.all()
    np.testing.assert_array_equal(time_ns, np.arange(CYCLES) * 10_000_000)
    assert about["fingerprint"] == contract.phi.fingerprint
    assert (about["layout"], about["solver"], about["device"]) == ("small", "live", "cpu")
    assert about["settings"]["penalty_n"] == 0.006
    assert about["source"] == path.name


def test_sums_of_a_recording_are_rounded_as_on_the_bus(force_n: np.ndarray, tmp_path: Path, out: Path) -> None:
    layout = small_layout(16, 16, **SMALL | {"encoding": {"sum_bits": 8}})
    assert packing(layout).scale > 1
    path, file = tmp_path / "mat.npy", tmp_path / "8bit.toml"
    np.save(path, force_n)
    file.write_text(layout_text(layout))
    rebuild(path, out=out, layout=file, full_scale=0.02)
    contract = Contract.from_layout(layout)
    electronics = Electronics(layout.taxels, noise_n=0.0)
    sums = np.stack([contract.phi.forward(electronics.read(each)) for each in force_n])
    sums = contract.packing.counts(contract.packing.raw(sums))
    np.testing.assert_array_equal(loaded(out)[0], live_images(contract, sums, np.ones((CYCLES, 16), np.bool_)))


def test_a_recording_of_a_skin_whose_sums_are_made_in_hardware(force_n: np.ndarray, tmp_path: Path, out: Path) -> None:
    """The last frame is beyond the converters: blocks with the row of all ones are not valid."""
    path, file = tmp_path / "mat.npy", tmp_path / "analogue.toml"
    np.save(path, np.concatenate([force_n, np.full((1, 16, 16), 0.02, np.float32)]))
    layout = small_layout(16, 16, **SMALL, taxels={"frontend": "analogue"})
    file.write_text(layout_text(layout))
    rebuild(path, out=out, layout=file, full_scale=0.02)
    images, valid, _, _ = loaded(out)
    phi = layout.phi()
    assert valid[:-1].all()
    np.testing.assert_array_equal(valid[-1], ~phi.kept[:, 0])
    assert np.abs(images[CYCLES - 1] - force_n[-1]).max() < 2e-3


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf"])
def test_a_log_gives_the_images_of_the_live_gateway(
    contract: Contract, sums: np.ndarray, layout_file: Path, tmp_path: Path, out: Path, suffix: str
) -> None:
    sent = messages(contract, sums)
    for each in sent:
        each.channel = {"left": "can0", "right": "can1"}[each.channel]
    path = write_log(tmp_path / f"can{suffix}", sent)
    rebuild(path, out=out, layout=layout_file)
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

    rebuild(recorded("page.mcap", phi.fingerprint), out=out)
    images, told, time_ns, _ = loaded(out)
    np.testing.assert_array_equal(told, valid)
    np.testing.assert_array_equal(images, live_images(contract, sums, valid))
    np.testing.assert_array_equal(time_ns, OFFSET_NS + np.arange(CYCLES) * 10_000_000)
    with pytest.raises(InputError, match="they are of another Φ"):
        rebuild(recorded("other.mcap", "another"), out=tmp_path / "other.npz")


def test_a_csv_of_frames_is_a_log(
    contract: Contract, sums: np.ndarray, layout_file: Path, tmp_path: Path, out: Path
) -> None:
    """A .csv has no channels: one bus, and the other is missing."""
    path = write_log(tmp_path / "can.csv", [each for each in messages(contract, sums) if each.channel == "left"])
    rebuild(path, out=out, layout=layout_file)
    images, valid, _, _ = loaded(out)
    assert valid[:, :8].all()
    assert not valid[:, 8:].any()
    kept = sums * valid[:, contract.phi.block_of_sum]
    np.testing.assert_array_equal(images, live_images(contract, kept, valid))


def test_only_what_the_gateway_would_use_counts(
    contract: Contract,
    sums: np.ndarray,
    layout_file: Path,
    tmp_path: Path,
    out: Path,
    capsys: pytest.CaptureFixture[str],
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

    rebuild(path, out=out, layout=layout_file)
    images, valid, _, _ = loaded(out)
    np.testing.assert_array_equal(valid, expected)
    kept = sums * expected[:, contract.phi.block_of_sum]
    np.testing.assert_array_equal(images, live_images(contract, kept, expected))
    said = capsys.readouterr().err
    assert "rebuild: 9 of 12 cycles are complete" in said
    assert "1 duplicate, 1 malformed, 1 foreign" in said
    assert "solver live, 10 iterations, on the cpu" in said
    assert f"12 images written to {out}" in said


def test_channels_of_a_log_by_name(contract: Contract, sums: np.ndarray, layout_file: Path, tmp_path: Path) -> None:
    sent = messages(contract, sums)
    for each in sent:
        each.channel = {"left": "vcan7", "right": "vcan2"}[each.channel]
    path, out = write_log(tmp_path / "can.log", sent), tmp_path / "images.npz"
    rebuild(path, out=out, layout=layout_file, channel=["vcan7", "vcan2"])
    assert loaded(out)[1].all()
    with pytest.raises(InputError, match="expected a channel of can0"):
        rebuild(path, out=tmp_path / "other.npz", layout=layout_file, channel=["can0"])


@pytest.mark.parametrize("solver", ["spun", "paper", "variation"])
def test_other_solvers(
    force_n: np.ndarray,
    layout_file: Path,
    tmp_path: Path,
    out: Path,
    capsys: pytest.CaptureFixture[str],
    solver: str,
) -> None:
    np.save(tmp_path / "mat.npy", force_n)
    rebuild(tmp_path / "mat.npy", out=out, layout=layout_file, solver=SolverOptions(solver, iterations=7))
    images, _, _, about = loaded(out)
    assert about["settings"]["iterations"] == 7
    assert np.abs(images - force_n).mean() < 0.001
    assert f"solver {solver}, 7 iterations, on the cpu" in capsys.readouterr().err


def test_any_wavelet(force_n: np.ndarray, layout_file: Path, tmp_path: Path, out: Path) -> None:
    np.save(tmp_path / "mat.npy", force_n)
    rebuild(tmp_path / "mat.npy", out=out, layout=layout_file, solver=SolverOptions("paper", basis="sym4-tensor"))
    images, _, _, about = loaded(out)
    assert about["settings"]["prior"] == "sym4-tensor"
    assert np.abs(images - force_n).mean() < 0.001


def test_the_gpu_path_on_a_cpu(
    force_n: np.ndarray,
    layout_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """NumPy in the place of CuPy: the images of the default solver are those of the CPU, but for rounding."""
    np.save(tmp_path / "mat.npy", force_n)
    monkeypatch.setattr("reconstructor.array_api.array_library", lambda _: NUMPY)
    made: dict[str, np.ndarray] = {}
    for device in get_args(Device):
        out = tmp_path / f"{device}.npz"
        rebuild(tmp_path / "mat.npy", out=out, layout=layout_file, solver=SolverOptions(device=device))
        made[device] = loaded(out)[0]
        assert f"on the {device}" in capsys.readouterr().err
    np.testing.assert_allclose(made["gpu"], made["cpu"], atol=1e-4)


def test_without_a_gpu_the_extra_is_named(
    force_n: np.ndarray, layout_file: Path, tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.save(tmp_path / "mat.npy", force_n)
    for name in ("cupy", "torch"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(InputError, match=r"\[torch\].*\[gpu\]"):
        rebuild(tmp_path / "mat.npy", out=out, layout=layout_file, solver=SolverOptions(device="gpu"))
    monkeypatch.setattr("reconstructor.array_api.array_library", lambda _: NUMPY)
    contourlets = SolverOptions("paper-contourlet", device="gpu")
    with pytest.raises(InputError, match="got contourlets; leave out --device gpu"):
        rebuild(tmp_path / "mat.npy", out=out, layout=layout_file, solver=contourlets)
    assert not out.exists()


def test_places_that_cannot_be_written_are_refused_before_the_work(
    layout_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rebuild_command, "measure_forces", lambda *_: pytest.fail("the work has begun"))
    source, there = tmp_path / "mat.npy", tmp_path / "there.npz"
    np.save(source, np.ones((1, 16, 16)))
    there.write_bytes(b"precious")
    for out, says in (
        (there, "is there already"),
        (tmp_path / "images.npy", "ends in .npz"),
        (tmp_path / "none" / "images.npz", "folder for the images does not exist"),
        (Path("/proc/images.npz"), "cannot write the images there"),
    ):
        with pytest.raises(InputError, match=says):
            rebuild(source, out=out, layout=layout_file)
    assert there.read_bytes() == b"precious"


def test_a_block_that_missed_a_frame_is_valid_again_in_the_next_cycle(
    contract: Contract, sums: np.ndarray, layout_file: Path, tmp_path: Path, out: Path
) -> None:
    sent = messages(contract, sums)
    of_cycle = [sent[k : k + len(sent) // CYCLES] for k in range(0, len(sent), len(sent) // CYCLES)]
    del of_cycle[1][len(contract.layout.bus)]
    path = write_log(tmp_path / "can.log", [each for cycle in of_cycle for each in cycle])
    rebuild(path, out=out, layout=layout_file)
    expected = np.ones((CYCLES, 16), np.bool_)
    expected[1, 0] = False
    np.testing.assert_array_equal(loaded(out)[1], expected)


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
        rebuild(log, out=out, layout=layout_file)
    assert str(refused.value).endswith("ogs of before the counter in each frame cannot be used any more")
    assert "\n" not in str(refused.value)
    assert not out.exists()


def test_a_recording_of_before_the_counter_is_refused_with_one_line(
    contract: Contract, tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = layout_text(contract.layout).replace("[sync]\n", '[sync]\nidentity = "window"\n')
    with monkeypatch.context() as patch:
        patch.setattr(sinks, "layout_text", lambda _: old)
        McapSink(path := tmp_path / "run.mcap", contract, 1, OFFSET_NS).close()
    with pytest.raises(LayoutError, match="the key `identity` went") as refused:
        rebuild(path, out=out)
    assert "logs and recordings of before cannot be used any more" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_cannot_be_used_is_named(
    contract: Contract, sums: np.ndarray, layout_file: Path, tmp_path: Path, out: Path
) -> None:
    np.save(tmp_path / "mat.npy", np.ones((1, 16, 16)))
    sent = messages(contract, sums)
    log = write_log(tmp_path / "can.log", sent)
    no_sync = write_log(tmp_path / "no-sync.log", [each for each in sent if each.arbitration_id != 0x80])
    for arguments, says in (
        ({"source": tmp_path / "none.log"}, "no file"),
        ({"source": tmp_path / "mat.npy", "channel": ["can0"]}, "leave out --channel"),
        ({"source": log, "array": ["a"]}, "leave out --array"),
        ({"source": log, "full_scale": 1.0}, "leave out --array and --full-scale"),
        ({"source": log, "channel": ["a", "b", "c"]}, "up to 2 channels"),
        ({"source": log, "solver": SolverOptions("best")}, "unknown solver 'best'"),
        ({"source": log, "solver": SolverOptions(basis="sim4")}, "unknown basis 'sim4': did you mean 'sym4'"),
        ({"source": log, "solver": SolverOptions("paper-contourlet", basis="sym4")}, "take another --solver"),
        ({"source": no_sync}, r"no SYNC with a counter \(COB-ID 80h, 1 byte\)"),
    ):
        with pytest.raises(InputError, match=says):
            rebuild(**arguments, out=out, layout=layout_file)
    assert not out.exists()


def test_a_log_of_another_layout_measures_nothing_and_fails(
    contract: Contract, sums: np.ndarray, tmp_path: Path, out: Path
) -> None:
    path, fd = write_log(tmp_path / "can.log", messages(contract, sums)), tmp_path / "fd.toml"
    fd.write_text(layout_toml(16, 16, **SMALL | {"bus": buses(8, 8, names=("left", "right"), fd=True)}))
    says = r"no block of any cycle is complete \(frames 0 accepted, .* is this the skin's layout\?"
    with pytest.raises(RunError, match=says):
        rebuild(path, out=out, layout=fd)
    assert not out.exists()


def test_a_full_disk_leaves_no_half_file(
    force_n: np.ndarray, layout_file: Path, tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    np.save(tmp_path / "mat.npy", force_n)
    monkeypatch.setattr("recording.rebuild_command.np.savez", full)
    with pytest.raises(RunError, match="cannot be written: No space left"):
        rebuild(tmp_path / "mat.npy", out=out, layout=layout_file)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mat.npy", "small.toml"]


def wire_layout(folder: Path, codes: np.ndarray) -> Path:
    """Write a layout of 16 x 16 taxels whose sums other hardware makes."""
    np.savez(folder / "codes.npz", phi=codes)
    path = folder / "wire.toml"
    path.write_text(layout_toml(16, 16, name="wire", measurement={"ensemble": "matrix", "matrix": "codes.npz"}))
    return path


def test_sums_of_other_hardware_with_a_phi_for_each_frame(force_n: np.ndarray, tmp_path: Path, out: Path) -> None:
    """Every fifth frame is lost, and every frame lacks a sum: the cycle tells the Φ, and only that sum is left out."""
    slow_n, codes = np.repeat(force_n[:10], 20, axis=0), np.random.default_rng(1).integers(0, 2, (60, 64, 256))
    layout = load_layout(wire_layout(tmp_path, codes))
    cycle = np.flatnonzero(np.arange(1, len(slow_n) + 1) % 5) + 1
    counts = np.rint(slow_n / layout.taxels.newton_per_count).astype(np.int32).reshape(len(slow_n), -1)
    sums = np.stack([codes[(each - 1) % 60] @ counts[each - 1] for each in cycle])
    valid = np.arange(64) != cycle[:, None] % 64
    np.savez(tmp_path / "sums.npz", sums=np.where(valid, sums, 10**6), valid=valid, cycle=cycle)
    rebuild(tmp_path / "sums.npz", out=out, layout=tmp_path / "wire.toml")
    images, came, time_ns, about = loaded(out)
    np.testing.assert_array_equal(came, valid)
    np.testing.assert_array_equal(time_ns, (cycle - 1) * 10_000_000)
    assert about["fingerprint"] == layout.operator().fingerprint
    assert np.sqrt(np.mean((images - slow_n[cycle - 1])[80:] ** 2)) < 0.0003


def test_a_recording_of_forces_is_measured_by_a_matrix(force_n: np.ndarray, tmp_path: Path, out: Path) -> None:
    path = wire_layout(tmp_path, np.random.default_rng(1).integers(0, 2, (60, 64, 256)))
    np.save(tmp_path / "mat.npy", np.repeat(force_n[:1], 100, axis=0))
    rebuild(tmp_path / "mat.npy", out=out, layout=path, full_scale=0.02)
    assert np.sqrt(np.mean((loaded(out)[0][-1] - force_n[0]) ** 2)) < 0.0002


def test_sums_that_a_program_kept_give_the_images_of_the_live_chain(
    contract: Contract, sums: np.ndarray, layout_file: Path, tmp_path: Path, out: Path
) -> None:
    np.savez(tmp_path / "sums.npz", sums=sums, time_ns=np.arange(CYCLES) * 7)
    rebuild(tmp_path / "sums.npz", out=out, layout=layout_file)
    images, valid, time_ns, _ = loaded(out)
    np.testing.assert_array_equal(images, live_images(contract, sums, valid))
    assert valid.all()
    np.testing.assert_array_equal(time_ns, np.arange(CYCLES) * 7)


def test_sums_that_came_in_turns_give_the_images_of_the_live_chain(sums: np.ndarray, tmp_path: Path, out: Path) -> None:
    layout, file = small_layout(16, 16, **SMALL | {"sync": {"turns": 2}}), tmp_path / "turns.toml"
    file.write_text(layout_text(layout))
    np.savez(tmp_path / "sums.npz", sums=sums)
    rebuild(tmp_path / "sums.npz", out=out, layout=file)
    images, valid, *_ = loaded(out)
    np.testing.assert_array_equal(images, live_images(Contract.from_layout(layout), sums, valid))


@pytest.mark.parametrize(
    ("arrays", "says"),
    [
        ({"sums": np.zeros((4, 63), np.int32)}, r"'sums': expected integers, ADC counts, of shape \(cycles, 64\)"),
        ({"sums": np.zeros((4, 64))}, "'sums': expected integers, ADC counts"),
        ({"sums": np.zeros((0, 64), np.int32)}, "'sums': expected integers, ADC counts"),
        ({"sums": np.full((4, 64), 2**31)}, "'sums': expected up to 2147483647 counts"),
        ({"sums": np.zeros((4, 64), int), "valid": np.ones(4, bool)}, r"'valid': expected booleans of shape \(4, 64\)"),
        ({"sums": np.zeros((4, 64), int), "cycle": np.ones(3, int)}, r"'cycle': expected integers of shape \(4,\)"),
        ({"sums": np.zeros((4, 64), int), "time_ns": np.ones(4)}, "'time_ns': expected integers"),
        ({"sums": np.full((4, 64), None)}, "cannot be read as .npz"),
    ],
)
def test_sums_that_do_not_fit_are_refused(tmp_path: Path, out: Path, arrays: dict[str, np.ndarray], says: str) -> None:
    path = wire_layout(tmp_path, np.ones((64, 256)))
    np.savez(tmp_path / "sums.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=says):
        rebuild(tmp_path / "sums.npz", out=out, layout=path)
    assert not out.exists()


def test_a_log_has_no_sums_of_a_matrix(contract: Contract, sums: np.ndarray, tmp_path: Path, out: Path) -> None:
    log = write_log(tmp_path / "can.log", messages(contract, sums))
    with pytest.raises(LayoutError, match="made by other hardware, not by boards on a bus"):
        rebuild(log, out=out, layout=wire_layout(tmp_path, np.ones((64, 256))))


def test_known_gains_of_analogue_sums_are_taken_off_and_one_sum_is_lost_alone(
    force_n: np.ndarray, tmp_path: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The last cycle is beyond the converters of some sums: the others make its image."""
    path, file, gains = tmp_path / "mat.npy", tmp_path / "analogue.toml", tmp_path / "gains.json"
    np.save(path, np.concatenate([force_n, np.full((1, 16, 16), 0.02, np.float32)]))
    layout = small_layout(16, 16, **SMALL, taxels={"frontend": "analogue"})
    file.write_text(layout_text(layout))
    known = 1 + 0.1 * np.random.default_rng(1).standard_normal(256)
    gains.write_bytes(encoded(new_calibration(layout, gains=known)))
    rebuild(path, out=out, layout=file, full_scale=0.02, gains=gains)
    cycles = measure_forces(layout, path, None, 0.02, lambda _: None)
    sums = zip(cycles.counts, cycles.valid, cycles.valid_sums, strict=True)
    imager = CycleImager(layout, gains=load_gains(gains, layout))
    expected = [imager.solve(MeasuredSums(*each))[0] for each in sums]
    np.testing.assert_array_equal(loaded(out)[0], expected)
    phi = layout.phi()
    assert cycles.valid_sums[-1].sum() == phi.shape[0] - np.count_nonzero(phi.kept[:, 0])
    monkeypatch.setattr("reconstructor.array_api.array_library", lambda _: NUMPY)
    with pytest.raises(InputError, match="a GPU solves cycles together"):
        rebuild(path, out=tmp_path / "b.npz", layout=file, gains=gains, solver=SolverOptions(device="gpu"))


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
        sink.message(MEASUREMENT, cycle * 10**6, msgspec.msgpack.encode(made))
        if cycle != 2:  # the live reconstructor was busy
            service.take(made)
            sink.message(IMAGE, cycle * 10**6, msgspec.msgpack.encode(shown[-1]))
    sink.close()
    return tmp_path / "run.mcap"


def test_an_stepped_run_is_rebuilt_as_it_was_shown(
    stepped_run: Path, out: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rebuild(stepped_run, out=out)
    images, valid, time_ns, about = loaded(out)
    assert time_ns.tolist() == [1_001_000, 3_001_000]
    assert (images.shape, valid.shape, valid.all()) == ((2, 8, 16), (2, 4), True)
    assert images[1].mean() == pytest.approx(3e-3, rel=0.1)
    assert about["solver"] == "steps"
    assert "2 of 2 images equal to the recorded" in capsys.readouterr().err
    rebuild(stepped_run, out=out.with_name("other.npz"), solver=SolverOptions("variation"))
    images, _, _, about = loaded(out.with_name("other.npz"))
    assert (len(images), about["solver"]) == (3, "variation")


def test_what_stepped_sums_are_not_made_from_is_one_clear_line(stepped_run: Path, tmp_path: Path, out: Path) -> None:
    np.save(tmp_path / "mat.npy", np.ones((2, 8, 16)))
    for source, options, says in (
        (stepped_run, {"solver": SolverOptions()}, "averages the sums of cycles, and steps have none"),
        (tmp_path / "mat.npy", {"layout": stepped_run}, "play it with 'skin demo --input'"),
    ):
        with pytest.raises(InputError, match=says):
            rebuild(source, out=out, **options)
