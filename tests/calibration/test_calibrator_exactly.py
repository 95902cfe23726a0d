"""When the zero of a skin without random noise is measured, what is said of it, and what it is, to the count."""

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from calibration.calibrator import Calibrator
from calibration.offline import measurement_of
from canskin.calibration_messages import CalibrationState
from canskin.messages import Measurement
from skin.layout import Layout, parse_layout

MS = 1_000_000
PERIOD_MS = 25
SKIN = b"[taxels]\nrows = 32\ncolumns = 32\n[sync]\nrate_hz = 40.0\n"
#: Boards that average their samples undo the bias of clipping themselves.
AVERAGING = parse_layout(SKIN + b"[sampling]\nrate_hz = 1000.0", "test")
PHI = AVERAGING.phi()
SUMS, NPC = PHI.shape[0], AVERAGING.taxels.newton_per_count
MEASURING, TOUCHED = CalibrationState.MEASURING, CalibrationState.TOUCHED
FOLLOWING, LOADED, OFF = CalibrationState.FOLLOWING, CalibrationState.LOADED, CalibrationState.OFF

Counts = npt.NDArray[np.int32]
NOTHING = np.zeros(SUMS, np.int32)
#: Offsets that no touch looks like.
OFFSETS: Counts = np.random.default_rng(3).integers(-50, 50, SUMS).astype(np.int32)


def pressed(row: int, column: int, width: int, counts: int) -> Counts:
    """Return the sums of a square of taxels that all read so many counts."""
    force = np.zeros((32, 32), np.int32)
    force[row : row + width, column : column + width] = counts
    return np.asarray(PHI.forward(force.ravel()), np.int32)


class Cycles:
    """Cycles 25 ms apart, ten in a window: the sums change by 2 · `noise` counts from cycle to cycle, up and down."""

    def __init__(self, layout: Layout = AVERAGING, noise: int = 3, **options: object) -> None:
        self.said: list[str] = []
        self.layout, self._noise = layout, noise
        self.made = Calibrator(layout, say=self.said.append, **options)  # type: ignore[arg-type]
        self.cycle = 0
        self.missing: list[int] = []

    def measured(self, counts: Counts) -> Measurement:
        valid = np.ones(PHI.blocks, np.bool_)
        valid[self.missing] = False
        shaken = counts + self._noise * (-1) ** self.cycle * np.where(np.arange(SUMS) % 3, 1, -1)
        return measurement_of(self.layout, PHI, self.cycle, shaken, valid)

    def run(self, windows: float, counts: Counts = OFFSETS, drift: float = 0.0) -> Measurement:
        """Go on for so many windows, with offsets that grow by `drift` counts in each; return the last as it went."""
        for _ in range(round(10 * windows)):
            moved = np.rint(counts + drift * self.cycle / 10).astype(np.int32)
            came = self.measured(moved)
            self.cycle += 1
            applied = self.made.apply(came)
            self.made.take(came)
            self.made.work()
        return applied

    @property
    def now_ns(self) -> int:
        """Time of the newest cycle."""
        return self.cycle * PERIOD_MS * MS


def offsets_of(measurement: Measurement) -> list[int]:
    return np.frombuffer(measurement.offsets, "<i4").tolist()


def tared(**options: object) -> Cycles:
    """Return a skin with a zero: two windows to settle, and eight."""
    skin = Cycles(**options)  # type: ignore[arg-type]
    skin.run(10.1)
    assert skin.made.state is FOLLOWING
    return skin


def test_a_zero_takes_half_a_second_and_two() -> None:
    skin = Cycles()
    assert skin.made.state is MEASURING
    assert skin.made.tare_s == 2.0
    assert skin.run(10).offsets == b""
    assert skin.made.state is MEASURING
    assert skin.made.result is None
    assert not skin.said
    skin.run(0.1)  # the cycle that ends the tenth window
    assert skin.made.state is FOLLOWING
    assert offsets_of(skin.run(0.1)) == OFFSETS.tolist()
    status = skin.made.status()
    # The middle of the window from 2275 to 2525 ms.
    assert status.tared_mono_ns == 2400 * MS
    assert (status.known_sums, status.revision, status.held_blocks, status.defects) == (SUMS, 1, 0, [])
    assert status.offset_rms_n == pytest.approx(NPC * np.sqrt(np.mean(OFFSETS.astype(np.float64) ** 2)))
    # Consecutive cycles differ by 6 counts: normal numbers of a deviation σ do by 2 σ / √π.
    assert status.noise_n == skin.made.noise_n == pytest.approx(6 * NPC * np.pi**0.5 / 2)
    assert status.drift_rms_n_per_s == 0


def test_what_is_said_of_a_zero() -> None:
    skin, offsets = Cycles(noise=300), 100 * OFFSETS
    skin.run(10.1, offsets)
    rms_mn = 1e3 * NPC * np.sqrt(np.mean(offsets.astype(np.float64) ** 2))
    largest_mn = 1e3 * NPC * np.abs(offsets).max()
    noise_mn = 1e3 * 600 * NPC * np.pi**0.5 / 2
    words = f"zero of {SUMS} of {SUMS} sums: offsets {rms_mn:.2f} mN rms, up to {largest_mn:.2f} mN"
    words += f"; noise {noise_mn:.2f} mN"
    assert skin.said == [words]
    assert skin.made.result is not None
    assert (skin.made.result.is_done, skin.made.result.text) == (True, words)


def test_a_zero_waits_for_half_of_the_sums() -> None:
    skin = Cycles()
    skin.missing = list(range(17))
    skin.run(12)
    assert skin.made.state is MEASURING
    assert skin.made.has_few_sums
    skin = Cycles()
    skin.missing = list(range(16))
    skin.run(10.1)
    assert skin.made.state is FOLLOWING
    assert not skin.made.has_few_sums
    assert skin.said[0].startswith(f"zero of {SUMS // 2} of {SUMS} sums")
    assert np.isnan(skin.made.offsets_n).sum() == SUMS // 2  # type: ignore[arg-type]


def test_has_few_sums_until_a_window_has_them() -> None:
    skin = Cycles()
    assert skin.made.has_few_sums
    skin.run(3)
    assert skin.made.has_few_sums
    skin.run(0.1)
    assert not skin.made.has_few_sums
    skin.made.tare()
    assert skin.made.has_few_sums


@pytest.mark.parametrize("late", [0, 4])
def test_an_even_drift_is_found_with_the_zero_and_foreseen(late: int) -> None:
    """Ten counts in each window of a quarter of a second."""
    skin = Cycles()
    skin.run(10.1 + late, drift=10.0)
    assert skin.made.status().drift_rms_n_per_s == pytest.approx(4 * 10 * NPC, rel=0.01)
    applied = skin.run(0.3, drift=10.0)
    expected = OFFSETS + 10.0 * (skin.cycle - 1) / 10
    assert np.abs(np.array(offsets_of(applied)) - expected).max() <= 1.5


def test_a_touch_at_the_start_is_told_once_with_its_place() -> None:
    skin = Cycles()
    hand = OFFSETS + pressed(10, 20, 5, 300)
    skin.run(14, hand)
    assert skin.made.state is TOUCHED
    words = (
        "something touches the skin or moves on it, around row 12, column 22: its zero is measured when it has been"
        " untouched for 2 s"
    )
    assert skin.said == [words]
    assert skin.made.result is not None
    assert (skin.made.result.is_done, skin.made.result.text) == (False, words)
    assert skin.made.status().tared_mono_ns == 0
    skin.run(8.1, OFFSETS)
    assert skin.made.state is FOLLOWING


def test_a_touch_during_a_later_zero_leaves_the_old_one() -> None:
    skin = tared()
    skin.made.tare()
    assert skin.made.result is None
    hand = OFFSETS + pressed(10, 20, 5, 300)
    assert offsets_of(skin.run(8.2, hand)) == OFFSETS.tolist()
    assert skin.made.state is FOLLOWING
    assert skin.said[1:] == [
        "something touches the skin or moves on it, around row 12, column 22: the zero stays as it was"
    ]
    assert skin.made.result is not None
    assert not skin.made.result.is_done
    assert skin.made.status().revision == 1


def test_a_forced_zero_takes_a_touch_for_its_own_once() -> None:
    skin = tared()
    hand = OFFSETS + pressed(10, 20, 5, 300)
    skin.made.tare(force=True)
    skin.run(8.2, hand)
    assert offsets_of(skin.run(0.1, hand)) == hand.tolist()
    assert skin.made.status().revision == 2
    skin.made.tare()
    skin.run(8.2, hand + pressed(2, 2, 5, 300))
    assert skin.made.result is not None
    assert not skin.made.result.is_done  # the next is not forced


def test_forces_below_zero_for_four_windows_ask_for_a_new_zero_and_then_for_eight() -> None:
    words = "forces below zero: what touched the skin when its zero was measured is gone; measures it anew"
    skin = Cycles()
    skin.made.tare(force=True)
    hand = OFFSETS + pressed(10, 20, 5, 300)
    skin.run(10.1, hand)
    skin.run(4, OFFSETS)
    assert (skin.made.state, skin.said[1:]) == (MEASURING, [words])
    skin.run(8.1, OFFSETS + pressed(2, 2, 5, 400))
    assert skin.made.state is FOLLOWING  # something else touches the skin: the zero stays as it was
    assert len(skin.said) == 3
    skin.run(7.9, OFFSETS)
    assert skin.made.state is FOLLOWING
    skin.run(0.1, OFFSETS)
    assert skin.said[3:] == [words]
    assert skin.made.state is MEASURING


def test_forces_below_zero_for_three_windows_are_forgotten() -> None:
    skin = Cycles()
    hand = OFFSETS + pressed(10, 20, 5, 300)
    skin.made.tare(force=True)
    skin.run(10.1, hand)
    skin.run(2.9, OFFSETS)
    for _ in range(4):
        skin.run(2, hand)
        skin.run(3, OFFSETS)
    assert skin.made.state is FOLLOWING
    assert len(skin.said) == 1


def test_under_a_touch_blocks_are_held_and_counted() -> None:
    skin = tared()
    skin.run(1, OFFSETS + pressed(0, 0, 20, 300))
    held = skin.run(1, OFFSETS + pressed(0, 0, 20, 300))
    assert skin.made.status().held_blocks == PHI.blocks
    assert offsets_of(held) == OFFSETS.tolist()
    skin.run(2, OFFSETS)
    assert skin.made.status().held_blocks == 0


def test_a_late_block_gets_its_zero_after_eight_windows_of_its_own() -> None:
    skin = Cycles()
    skin.missing = [4]
    skin.run(10.1)
    assert skin.made.status().known_sums == SUMS - 8
    skin.missing = []
    last = skin.run(9.9)  # half a second to settle, and eight windows, of which the last ends with the next cycle
    assert skin.made.status().known_sums == SUMS - 8
    usable = np.frombuffer(last.usable, np.uint8)
    assert np.flatnonzero(usable == 0).tolist() == np.flatnonzero(PHI.block_of_sum == 4).tolist()
    skin.run(0.1)
    assert skin.made.status().known_sums == SUMS
    last = skin.run(0.1)
    assert last.usable == b""
    assert offsets_of(last) == OFFSETS.tolist()
    assert skin.made.status().revision == 1


@pytest.mark.parametrize(
    ("part", "sampling", "has_bias"),
    [(1.05, b"", True), (0.95, b"", False), (1.05, b"[sampling]\nrate_hz = 80.0", False)],
)
def test_the_mean_of_clipped_noise_is_left_in_sums_of_single_samples(
    part: float, sampling: bytes, has_bias: bool
) -> None:
    """The paper's sensor has 1 mN, a sum of 32 5.7 mN; below 0.3 times that the sensor adds none."""
    limit = 0.3 * 1e-3 * 32**0.5
    noise = round(part * limit / NPC / np.pi**0.5)
    layout = parse_layout(SKIN + sampling, "test")
    skin = Cycles(layout, noise=noise)
    skin.run(10.2)
    assert skin.made.state is FOLLOWING
    bias = 32 * 1e-3 / np.sqrt(2 * np.pi) / NPC if has_bias else 0.0
    expected = OFFSETS - np.where(PHI.row_of_sum == 0, bias, 0.0)
    assert np.abs(np.array(offsets_of(skin.run(0.1))) - expected).max() < 0.51
    # What follows keeps it.
    skin.run(5)
    assert np.abs(np.array(offsets_of(skin.run(0.1))) - expected).max() < 0.51


def test_loaded_offsets_hold_at_once_and_end_a_measurement() -> None:
    skin = Cycles()
    skin.run(5)
    known = np.where(np.arange(SUMS) == 7, np.nan, OFFSETS * NPC)
    skin.made.load(known)
    assert skin.made.state is MEASURING
    assert skin.made.result is not None
    assert (skin.made.result.is_done, skin.made.result.text) == (False, "other offsets were loaded meanwhile")
    applied = skin.made.apply(skin.measured(OFFSETS))
    assert offsets_of(applied) == np.where(np.arange(SUMS) == 7, 0, OFFSETS).tolist()
    assert np.flatnonzero(np.frombuffer(applied.usable, np.uint8) == 0).tolist() == [7]
    assert skin.made.status().revision == 1
    status = tared().made
    status.load(known)
    assert status.result is None  # nothing was being measured
    assert (status.status().revision, status.status().tared_mono_ns, status.status().drift_rms_n_per_s) == (2, 0, 0.0)


def test_forgotten_offsets_are_measured_as_at_the_start() -> None:
    skin = tared()
    skin.made.forget()
    assert (skin.made.state, skin.made.offsets_n, skin.made.result) == (MEASURING, None, None)
    assert skin.run(1).offsets == b""
    skin.made.forget()
    assert skin.made.result is not None
    assert (skin.made.result.is_done, skin.made.result.text) == (False, "the nodes were written to meanwhile")
    assert skin.made.status().revision == 3
    skin.run(9.2)
    assert skin.made.status().revision == 4


def test_without_taring_nothing_is_learned_unless_it_is_asked_for() -> None:
    skin = Cycles(tares=False)
    assert skin.made.state is OFF
    skin.run(12)
    assert skin.made.state is OFF
    assert skin.made.offsets_n is None
    skin.made.load(OFFSETS * NPC)
    assert skin.made.state is LOADED
    skin.made.forget()
    assert (skin.made.state, skin.made.offsets_n) == (OFF, None)
    skin.made.tare()
    assert skin.made.state is MEASURING
    skin.run(10.1)
    assert skin.made.state is LOADED
    assert offsets_of(skin.run(5, OFFSETS + 100)) == OFFSETS.tolist()  # nothing is followed


def test_a_part_of_the_sums_gets_its_offsets() -> None:
    skin = tared()
    places = np.array([3, 200, 9])
    part = msgspec.structs.replace(skin.measured(OFFSETS), usable=b"\1\0\1")
    applied = skin.made.apply(part, places)
    assert offsets_of(applied) == OFFSETS[places].tolist()
    assert applied.usable == b"\1\0\1"
    assert skin.made.apply(msgspec.structs.replace(part, usable=b""), places).usable == b""


def test_a_gap_of_whole_windows_is_skipped() -> None:
    """A drift of ten counts a window goes on through five windows without cycles."""
    skin = Cycles()
    skin.run(14.1, drift=10.0)
    skin.cycle += 50
    applied = skin.run(0.1, drift=10.0)
    expected = OFFSETS + 10.0 * (skin.cycle - 1) / 10
    assert np.abs(np.array(offsets_of(applied)) - expected).max() <= 3
    skin.run(6, drift=10.0)
    assert np.abs(np.array(offsets_of(skin.run(0.1, drift=10.0))) - (expected + 61)).max() <= 3


def test_cycles_are_needed_while_a_zero_is_measured_and_after_sixty_windows() -> None:
    skin = Cycles()
    window_ns = 250 * MS
    assert skin.made.needs_cycles(0)
    skin.run(10.1)
    newest_ns = 2400 * MS
    assert not skin.made.needs_cycles(newest_ns + 60 * window_ns)
    assert skin.made.needs_cycles(newest_ns + 60 * window_ns + 1)
    asked_ns = newest_ns + 60 * window_ns + 1
    # Without cycles they are asked for again and again; with a new window, for four in all.
    skin.cycle = asked_ns // (PERIOD_MS * MS)
    skin.run(1.1)
    assert skin.made.needs_cycles(asked_ns + 4 * window_ns - 1)
    assert not skin.made.needs_cycles(asked_ns + 4 * window_ns)
    off = Cycles(tares=False)
    assert not off.made.needs_cycles(10**12)
