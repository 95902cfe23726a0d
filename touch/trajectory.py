"""How an object moves against the skin over time."""

from dataclasses import dataclass
from typing import Final

from touch.contact import Pose

#: The paper's trajectory: 1 kHz, 1100 steps of pressing at 0.01 m/s from a gap of 1 mm, 3100 of sliding.
PAPER_STEPS: Final = 4200
PAPER_PRESS_STEPS: Final = 1100
PAPER_GAP_STEPS: Final = 100
PAPER_PRESS_M_PER_STEP: Final = 1e-5
PAPER_SLIDE_M_PER_STEP: Final = (-2e-5, -4e-5)
#: Depth at the last pressing step, where the classification data are taken.
PAPER_DEPTH_M: Final = (PAPER_PRESS_STEPS - 1 - PAPER_GAP_STEPS) * PAPER_PRESS_M_PER_STEP
#: Where the golf ball starts; those of the other objects are not published.
GOLF_START_M: Final = (0.06, 0.06)


def paper_pose(step: int, start_m: tuple[float, float] = GOLF_START_M, rotation_rad: float = 0.0) -> Pose:
    """Return the pose at `step` (0 to 4199, 1 ms each) of the paper's trajectory.

    Parameters
    ----------
    step : int
        Before 0 and after the last step the pose is that of the nearest step.
    start_m : tuple of float
        Position x, y while the object is pressed in.
    rotation_rad : float
        Kept throughout.
    """
    step = min(max(step, 0), PAPER_STEPS - 1)
    pressing = min(step, PAPER_PRESS_STEPS - 1)
    sliding = step - pressing
    depth = max(0, pressing - PAPER_GAP_STEPS) * PAPER_PRESS_M_PER_STEP
    dx, dy = PAPER_SLIDE_M_PER_STEP
    return Pose(start_m[0] + dx * sliding, start_m[1] + dy * sliding, rotation_rad, depth)


@dataclass(frozen=True)
class Stroke:
    """Press, hold, slide in a straight line, and lift, each at constant speed.

    Attributes
    ----------
    start_m, end_m : tuple of float
        Position x, y before and after the slide.
    rotation_rad : float
        Kept throughout.
    depth_m : float
        Reached at the end of the press and kept until the lift.
    press_s, hold_s, slide_s, lift_s : float
        Duration of each phase.
    """

    start_m: tuple[float, float]
    end_m: tuple[float, float]
    rotation_rad: float
    depth_m: float
    press_s: float
    hold_s: float
    slide_s: float
    lift_s: float

    @property
    def duration_s(self) -> float:
        """From the first touch to the last."""
        return self.press_s + self.hold_s + self.slide_s + self.lift_s

    def pose(self, time_s: float) -> Pose:
        """Return the pose `time_s` after the first touch; outside the stroke the depth is 0."""
        slid = _progress(time_s - self.press_s - self.hold_s, self.slide_s)
        pressed = _progress(time_s, self.press_s)
        lifted = _progress(time_s - self.duration_s + self.lift_s, self.lift_s)
        (x0, y0), (x1, y1) = self.start_m, self.end_m
        return Pose(
            x0 + (x1 - x0) * slid,
            y0 + (y1 - y0) * slid,
            self.rotation_rad,
            self.depth_m * min(pressed, 1.0 - lifted),
        )


def _progress(elapsed_s: float, duration_s: float) -> float:
    """Return how much of a phase is done, 0 to 1; a phase of no duration is done when it begins."""
    if elapsed_s >= duration_s:
        return 1.0
    return elapsed_s / duration_s if elapsed_s > 0.0 else 0.0
