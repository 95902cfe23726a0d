"""Gains of taxels from a weight that was rolled over the skin, and from a table."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from calibration.gain_files import stored_gains
from calibration.gains import Gains, defects_of, find_gains
from canskin.errors import InputError, RunError
from canskin.messages import IMAGE, MEASUREMENT
from recording.mcap_file import CALIBRATION_FILE, File, RecordingWriter
from skin.calibration_file import StoredCalibration, encoded, load_calibration, new_calibration
from skin.defects import Defects, Stage, SumGains
from skin.frontend import with_gains
from skin.phi import fast_hadamard, sbhe
from skin.surface import surface_of_positions
from tests import messages as make
from tests import surfaces
from tests.layouts import small_layout

LAYOUT = small_layout(32, 32)
PHI = LAYOUT.phi()
SIDE = 32
SURFACE = LAYOUT.taxels.surface
FORCE_N = 0.3


def rolled() -> np.ndarray:
    """Forces of a round weight that rolls over all of the skin, shape (cycles, rows, columns)."""
    rows, columns = np.mgrid[:SIDE, :SIDE]
    centres = [(row, column) for row in np.arange(0, SIDE, 2.5) for column in np.arange(0, SIDE, 0.7)]
    depth = [np.clip(1 - ((rows - row) ** 2 + (columns - column) ** 2) / 16, 0, None) for row, column in centres]
    return FORCE_N / 25 * np.stack(depth)


FORCES = rolled()
WHOLE_N = float(np.median(FORCES.sum(axis=(1, 2))))


def felt(gains: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return sums with noise, and images that are a little too smooth."""
    random = np.random.default_rng(2)
    read = FORCES.reshape(len(FORCES), -1) * gains
    sums = PHI.forward(read) + random.normal(0, 2e-4, (len(read), PHI.shape[0]))
    images = 0.7 * read + 0.3 * FORCES.reshape(read.shape) + random.normal(0, 1e-4, read.shape)
    return sums, np.maximum(images, 0).reshape(FORCES.shape)


@pytest.fixture(scope="module")
def gains() -> np.ndarray:
    return np.random.default_rng(1).normal(1, 0.1, PHI.shape[1])


def test_gains_are_found_within_a_few_percent(gains: np.ndarray) -> None:
    found = find_gains(PHI, SURFACE, *felt(gains), WHOLE_N)
    error = found.gains / gains - 1
    assert found.known.mean() > 0.6
    assert error[found.known].std() < 0.03
    assert abs(error[found.known].mean()) < 0.03
    assert (found.gains[~found.known] == 1).all()
    assert defects_of(found, PHI, SURFACE) == []


def test_gains_are_found_on_a_tube_of_positions_except_at_its_ends() -> None:
    positions_m = surfaces.tube(20)
    skin, phi = surface_of_positions(positions_m.tolist()), sbhe(480, 240, block_size=16)
    random = np.random.default_rng(4)
    gains = random.normal(1, 0.1, 480)
    ends = np.isin(np.arange(480) // 24, (0, 19))
    along = random.uniform(0, 19 * 0.0068, 3000)
    angle = random.uniform(0, 2 * np.pi, 3000)
    centres = np.stack((0.03 * np.cos(angle), 0.03 * np.sin(angle), along), axis=1)
    apart_m = np.linalg.norm(positions_m - centres[:, None], axis=2)
    forces = np.clip(1 - (apart_m / 0.018) ** 2, 0, None) * 0.02
    forces *= 0.3 / forces.sum(axis=1, keepdims=True)
    read = forces * gains
    sums = np.asarray(phi.forward(read), np.float64) + random.normal(0, 2e-4, (3000, 240))
    found = find_gains(phi, skin, sums, read.reshape(3000, 1, 480), 0.3)
    assert found.cycles == np.sum(~(read > 0.05 * read.max(axis=1, keepdims=True))[:, ends].any(axis=1))
    assert not found.known[ends].any()
    assert found.known.mean() > 0.6
    assert (found.gains / gains - 1)[found.known].std() < 0.03
    gone = gains.copy()
    gone[245] = 0.0
    dead = find_gains(phi, skin, np.asarray(phi.forward(forces * gone)), forces * gone, 0.3)
    assert [text.split(" feels")[0] for text in defects_of(dead, phi, skin)] == ["taxel 245"]


@pytest.mark.heavy
def test_gains_of_analogue_sums_are_found_beside_those_of_taxels(gains: np.ndarray) -> None:
    """Gains of 5 % of the paths and of 10 % of the taxels: what is left is a small part of both."""
    (made,) = Defects.of({"mismatch": 0.05}, 3).effects(Stage.SUM_PATHS, PHI.shape[:1])
    readings = (FORCES.reshape(len(FORCES), -1) * gains).astype(np.float32)
    noise = np.random.default_rng(2).normal(0, 2e-4, (len(readings), PHI.shape[0]))
    sums = with_gains(PHI, readings, PHI.forward(readings), made) + noise
    found = find_gains(PHI, SURFACE, sums, felt(gains)[1], WHOLE_N, is_analogue=True)
    assert found.sums is not None
    assert (found.gains / gains - 1)[found.known].std() < 0.04
    chains = PHI.taxels_of_blocks[PHI.block_of_sum]
    signs = np.asarray(fast_hadamard(np.eye(PHI.block_size)))[PHI.row_of_sum]

    def weights(taxels: np.ndarray, of_sums: SumGains) -> np.ndarray:
        return taxels[chains] * (of_sums.differential[:, None] * signs + of_sums.common_mode[:, None])

    assert (weights(gains, made) / signs).std() > 0.08
    error = (weights(found.gains, found.sums) / weights(gains, made) - 1)[found.known[chains]]
    assert error.std() < 0.02
    assert abs(error.mean()) < 0.03
    rows = PHI.row_of_sum > 0  # of the row of all ones D + C alone can be found
    assert (found.sums.common_mode - made.common_mode)[rows].std() < 0.1 * made.common_mode.std()


def recording(
    path: Path,
    gains: np.ndarray,
    *,
    images: bool = True,
    zero: bool = True,
    restart: int = 0,
    attached: StoredCalibration | None = None,
) -> Path:
    files = [] if attached is None else [File(CALIBRATION_FILE, "application/json", encoded(attached))]
    writer = RecordingWriter(path, {}, files, 1)
    writer.add_topic(MEASUREMENT.name, "msgpack", {})
    writer.add_topic(IMAGE.name, "msgpack", {})
    newton_per_count = LAYOUT.taxels.newton_per_count
    offsets = np.arange(PHI.shape[0], dtype="<i4")
    for cycle, (sums_n, image) in enumerate(zip(*felt(gains), strict=True), 1):
        stamps = {"cycle": cycle - restart if cycle > restart else cycle, "sync_counter": 1, "sampled_mono_ns": cycle}
        valid = b"\1" * PHI.blocks
        counts = np.rint(sums_n / newton_per_count).astype("<i4") + offsets
        made = make.measurement(
            **stamps,
            sums=counts.tobytes(),
            valid=valid,
            fingerprint=PHI.fingerprint,
            offsets=offsets.tobytes() if zero else b"",
        )
        writer.message(MEASUREMENT, cycle, msgspec.msgpack.encode(made))
        if images:
            shown = make.image(**stamps, pixels=image.astype("<f4").tobytes(), valid=valid)
            writer.message(IMAGE, cycle, msgspec.msgpack.encode(shown))
    writer.close()
    return path


@pytest.mark.heavy
def test_gains_of_a_second_roll_multiply_those_of_the_first(
    gains: np.ndarray, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    set_ = new_calibration(LAYOUT, gains=np.linspace(0.8, 1.2, PHI.shape[1]))
    (tmp_path / "first.json").write_bytes(encoded(set_))
    path = recording(tmp_path / "run.mcap", gains)
    once = np.array(stored_gains(LAYOUT, path, WHOLE_N).gains)
    assert "taken as 1" in capsys.readouterr().err
    twice = stored_gains(LAYOUT, path, WHOLE_N, tmp_path / "first.json")
    np.testing.assert_allclose(twice.gains, once * set_.gains)
    attached = recording(tmp_path / "attached.mcap", gains, attached=set_)
    np.testing.assert_allclose(stored_gains(LAYOUT, attached, WHOLE_N).gains, twice.gains)
    (tmp_path / "none.json").write_bytes(encoded(new_calibration(LAYOUT, offsets_n=np.zeros(PHI.shape[0]))))
    with pytest.raises(InputError, match=r"none\.json: has no gains"):
        stored_gains(LAYOUT, path, WHOLE_N, tmp_path / "none.json")


@pytest.mark.heavy
def test_cycles_of_a_gateway_that_started_again_are_other_cycles(gains: np.ndarray, tmp_path: Path) -> None:
    whole = stored_gains(LAYOUT, recording(tmp_path / "run.mcap", gains), WHOLE_N)
    twice = stored_gains(LAYOUT, recording(tmp_path / "twice.mcap", gains, restart=len(FORCES) // 2), WHOLE_N)
    assert twice.gains == pytest.approx(whole.gains)


@pytest.mark.heavy
def test_a_roll_over_an_analogue_skin_stores_the_gains_of_its_sums(gains: np.ndarray, tmp_path: Path) -> None:
    replace = msgspec.structs.replace
    analogue = replace(LAYOUT, taxels=replace(LAYOUT.taxels, frontend="analogue"))
    path = recording(tmp_path / "run.mcap", gains)
    stored = stored_gains(analogue, path, WHOLE_N)
    assert len(stored.differential_gains) == len(stored.common_mode_gains) == PHI.shape[0]
    (tmp_path / "gains.json").write_bytes(encoded(stored))
    loaded = load_calibration(tmp_path / "gains.json", analogue)
    assert loaded == stored
    of_sums = loaded.sum_gains()
    assert of_sums is not None
    np.testing.assert_array_equal(of_sums.common_mode, stored.common_mode_gains)
    with pytest.raises(InputError, match="--before is for nodes that take off gains"):
        stored_gains(analogue, path, WHOLE_N, tmp_path / "gains.json")


def test_a_dead_taxel_gets_no_gain(gains: np.ndarray, tmp_path: Path) -> None:
    broken, dead = gains.copy(), 16 * SIDE + 12
    broken[dead] = 0
    stored = stored_gains(LAYOUT, recording(tmp_path / "run.mcap", broken), WHOLE_N)
    assert stored.gains[dead] == 1
    assert len(stored.defects) == 1


def test_a_recording_without_a_zero_is_refused(gains: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="have no offsets"):
        stored_gains(LAYOUT, recording(tmp_path / "run.mcap", gains, zero=False), WHOLE_N)


def test_a_recording_without_images_is_refused(gains: np.ndarray, tmp_path: Path) -> None:
    with pytest.raises(RunError, match="skin replay --out"):
        stored_gains(LAYOUT, recording(tmp_path / "run.mcap", gains, images=False), WHOLE_N)


def test_gains_of_a_table(gains: np.ndarray, tmp_path: Path) -> None:
    path = tmp_path / "gains.csv"
    np.savetxt(path, gains.reshape(SIDE, SIDE), delimiter=",")
    assert stored_gains(LAYOUT, path, None).gains == pytest.approx(gains)
    np.savetxt(path, gains.reshape(SIDE, SIDE)[1:], delimiter=",")
    with pytest.raises(InputError, match="expected 32 lines of 32 gains"):
        stored_gains(LAYOUT, path, None)


def test_a_hundred_cycles_with_the_whole_weight_are_enough(gains: np.ndarray) -> None:
    sums, images = felt(gains)
    row, column = (np.tensordot(FORCES, each, 2) / FORCES.sum(axis=(1, 2)) for each in np.mgrid[:SIDE, :SIDE])
    inner = np.flatnonzero((np.abs(row - 15.5) < 9) & (np.abs(column - 15.5) < 9))[:100]
    outer = np.flatnonzero(row < 2)[:50]  # part of the weight is beyond the border
    chosen = np.concatenate([outer, inner])
    assert find_gains(PHI, SURFACE, sums[chosen], images[chosen], WHOLE_N).cycles == 100
    with pytest.raises(InputError, match="in 99 cycles, expected 100 or more"):
        find_gains(PHI, SURFACE, sums[chosen[:-1]], images[chosen[:-1]], WHOLE_N)


def test_taxels_and_sums_that_feel_less_than_three_tenths_are_named() -> None:
    found = np.full(PHI.shape[1], 1.0)
    found[[3, 33, 70, 71]] = 0.29, -0.2, 0.3, 0.1
    known = np.arange(PHI.shape[1]) != 71
    all_ones = int(np.flatnonzero(PHI.row_of_sum == 0)[0])
    other = int(np.flatnonzero(PHI.row_of_sum > 0)[0])
    differential, common_mode = np.ones(PHI.shape[0]), np.zeros(PHI.shape[0])
    differential[[all_ones, other]], common_mode[[all_ones, other]] = 0.5, -0.25
    words = defects_of(Gains(found, known, 100, SumGains(differential, common_mode)), PHI, SURFACE)
    assert words == [
        "taxel 3 (row 0, column 3) feels 29%",
        "taxel 33 (row 1, column 1) feels 0%",
        # The row of all ones has one path: D + C.
        f"sum {all_ones} (block {PHI.block_of_sum[all_ones]}, row 0) feels 25% and is not used",
    ]
    assert defects_of(Gains(found, known, 100), PHI, SURFACE) == words[:2]


def test_too_few_cycles_are_refused(gains: np.ndarray) -> None:
    sums, images = felt(gains)
    with pytest.raises(InputError, match="in 0 cycles, expected 100 or more"):
        find_gains(PHI, SURFACE, sums[:20], images[:20], WHOLE_N)
