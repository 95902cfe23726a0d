"""The zero of a skin whose boards follow their own: a person settles what they cannot know of."""

from collections.abc import Callable

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from calibration.calibrator import LOOK_S, Calibrator
from canskin.calibration_messages import CalibrationState, ZeroSupport
from canskin.messages import Measurement
from canskin.sums import doubtful_taxels
from dbc.contract import Contract
from skin.frontend import sum_step_n
from skin.measured_sums import decode_stepped
from tests.calibration.helpers import pressed
from tests.layouts import STEPPED_SKIN
from tests.messages import stepped_measurement

PHI = STEPPED_SKIN.phi()
UNIT_N = Contract.from_layout(STEPPED_SKIN).unit_n
NEWTON_PER_COUNT = STEPPED_SKIN.taxels.newton_per_count
Force = npt.NDArray[np.float64]
NOTHING, WEIGHT, OTHER = np.zeros(PHI.shape[1]), pressed(20, 20, 9, 0.005), pressed(44, 40, 7, 0.008)


class Skin:
    """A skin that sends sums in units, with noise where something touches."""

    def __init__(self, *, tares: bool = True) -> None:
        self.made, self._time_s = Calibrator(STEPPED_SKIN, tares=tares), 0.0
        self._random = np.random.default_rng(0)

    def run(self, seconds: float, force: Force | Callable[[float], Force], valid: bytes = b"") -> Measurement:
        for _ in range(round(seconds / LOOK_S)):
            self._time_s += LOOK_S
            force_n = force(self._time_s) if callable(force) else force
            sums_n = PHI.forward(force_n + np.where(force_n > 0, self._random.normal(0, 1e-4, force_n.size), 0))
            coded_n = np.rint(sums_n / UNIT_N) * UNIT_N
            came = msgspec.structs.replace(
                stepped_measurement(NOTHING, layout=STEPPED_SKIN, sampled_mono_ns=round(1e9 * self._time_s)),
                sums=np.rint(coded_n / NEWTON_PER_COUNT).astype("<i4").tobytes(),
            )
            came = msgspec.structs.replace(came, valid=valid or came.valid)
            last = self.made.apply(came)
            self.made.take(came)
            self.made.work()
        return last


def picture_n(measurement: Measurement) -> Force:
    """Return the forces of all sums less offsets."""
    return np.asarray(PHI.adjoint(decode_stepped(measurement, PHI).counts * NEWTON_PER_COUNT) / PHI.block_size)


def test_the_step_of_a_sum_is_the_unit_of_words() -> None:
    assert sum_step_n(STEPPED_SKIN) == pytest.approx(UNIT_N) == pytest.approx(0.64 / 8192)


def test_touches_that_come_and_go_leave_the_zero_and_are_not_doubtful() -> None:
    skin = Skin()
    assert skin.made.state is CalibrationState.FOLLOWING
    moving = skin.run(8.0, lambda time_s: pressed(10 + round(4 * time_s), 24, 9, 0.005))
    calm = skin.run(3.0, NOTHING)
    assert (moving.offsets, moving.doubtful, calm.offsets, calm.doubtful) == (b"", b"", b"", b"")
    status = skin.made.status()
    assert set(status.zero_support) == {ZeroSupport.MEASURED}
    assert (status.offset_rms_n, status.drift_rms_n_per_s, status.defects) == (0, 0, [])


@pytest.mark.parametrize("region", [None, (18, 18, 30, 30)])
def test_a_still_weight_is_doubtful_until_it_is_settled_and_the_zero_returns_when_it_leaves(
    region: tuple[int, int, int, int] | None,
) -> None:
    skin = Skin()
    still = skin.run(8.0, WEIGHT)
    np.testing.assert_array_equal(doubtful_taxels(still, WEIGHT.size), WEIGHT > 0)
    skin.made.tare(region=region)
    settled = skin.run(3.0, WEIGHT)
    assert skin.made.result is not None
    assert skin.made.result.is_done
    assert (settled.doubtful, skin.made.state) == (b"", CalibrationState.FOLLOWING)
    assert np.abs(picture_n(settled)).max() < 0.5e-3
    assert ZeroSupport.TOLD in skin.made.status().zero_support
    both = skin.run(2.0, WEIGHT + OTHER)
    np.testing.assert_allclose(picture_n(both), OTHER, atol=0.6e-3)
    alone = skin.run(2.0, OTHER)
    np.testing.assert_allclose(picture_n(alone), OTHER, atol=0.6e-3)
    left = skin.run(2.0, NOTHING)
    assert np.abs(picture_n(left)).max() < 0.15e-3


@pytest.mark.parametrize("tares", [True, False])
def test_a_tare_by_force_settles_what_a_plain_one_refuses(*, tares: bool) -> None:
    skin = Skin(tares=tares)
    skin.run(1.0, WEIGHT)
    skin.made.tare()
    assert skin.run(3.0, WEIGHT).offsets == b""
    assert skin.made.result is not None
    assert not skin.made.result.is_done
    assert skin.made.state is (CalibrationState.FOLLOWING if tares else CalibrationState.OFF)
    skin.made.tare(force=True)
    assert np.abs(picture_n(skin.run(3.0, WEIGHT))).max() < 0.5e-3
    assert skin.made.state is (CalibrationState.FOLLOWING if tares else CalibrationState.LOADED)
    skin.made.forget()
    assert skin.run(0.1, WEIGHT).offsets == b""
    assert skin.made.state is (CalibrationState.FOLLOWING if tares else CalibrationState.OFF)


def test_blocks_that_are_not_valid_say_nothing_of_their_zero() -> None:
    """Blocks of a settled weight are lost, and come with the weight: it stays settled."""
    skin = Skin()
    skin.run(1.0, WEIGHT)
    skin.made.tare(force=True)
    skin.run(3.0, WEIGHT)
    lost = np.ones(PHI.blocks, np.uint8)
    lost[np.unique(PHI.block_of_taxel[WEIGHT > 0])] = 0
    skin.run(3.0, NOTHING, lost.tobytes())
    assert np.abs(picture_n(skin.run(2.0, WEIGHT))).max() < 0.5e-3
