"""A minute of touch and video in a LeRobot data set, read back: policy steps at 30 Hz, skin at 100 Hz."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("lerobot", reason="NOT TESTED: the skin in data sets of LeRobot, for want of lerobot")

from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.utils.feature_utils import build_dataset_frame, hw_to_dataset_features

from lerobot_camera_canskin import CanskinCamera, CanskinCameraConfig, features, forces
from tests.client.lerobot_camera_canskin.conftest import LATENCY_NS, PERIOD_NS, ClockedSkin, force_n, valid

FPS, SECONDS, WINDOW = 30, 60, 4
STEPS = FPS * SECONDS
#: The robot starts when the window is full.
START_NS = 5 * PERIOD_NS + LATENCY_NS


def video(step: int) -> np.ndarray:
    """Return the synthetic camera's image of a step."""
    return np.full((12, 16, 3), (step % 256, step // 256, 99), np.uint8)


def at_ns(step: int) -> int:
    return START_NS + step * 1_000_000_000 // FPS


def newest(step: int) -> int:
    """Return the newest cycle whose frame has come when a step begins."""
    return (at_ns(step) - LATENCY_NS) // PERIOD_NS


@pytest.fixture
def recorded(clocked: ClockedSkin, tmp_path: Path) -> LeRobotDataset:
    """Record as a robot with a camera, a skin and a joint does: features and frames are made by LeRobot."""
    config = CanskinCameraConfig(window=WINDOW, height=4 * WINDOW, width=4, fps=FPS)
    camera = CanskinCamera(config)
    hardware = {"joint.pos": float, "front": (12, 16, 3), "skin": (config.height, config.width, 3)}
    columns = {**hw_to_dataset_features(hardware, "observation", use_video=False), **features(WINDOW, 4, 4)}
    dataset = LeRobotDataset.create("me/touch", FPS, columns, root=tmp_path / "touch", use_videos=False)
    camera.connect(warmup=False)
    for step in range(STEPS):
        clocked.advance(at_ns(step))
        assert camera._buffer.wait_for(clocked.hub.count, 20.0, 1.0)
        observation = {"joint.pos": float(step), "front": video(step), "skin": camera.read_latest()}
        images = build_dataset_frame(hw_to_dataset_features(hardware, "observation"), observation, "observation")
        dataset.add_frame({**images, **camera.touch.observation(), "task": "press"})
    assert camera.lost == 0
    camera.disconnect()
    dataset.save_episode()
    dataset.finalize()
    return LeRobotDataset("me/touch", root=tmp_path / "touch")


@pytest.mark.slow
def test_a_minute_with_skin_and_camera_is_read_back_whole(recorded: LeRobotDataset) -> None:
    assert recorded.num_frames == STEPS
    found: dict[int, int] = {}
    for step in range(STEPS):
        item = recorded[step]
        assert item["timestamp"].item() == pytest.approx(step / FPS, abs=1e-5)
        assert item["observation.state"].item() == step
        assert np.array_equal(as_uint8(item["observation.images.front"]), video(step))

        cycles = item["observation.skin.cycle"].numpy()
        assert cycles.tolist() == list(range(newest(step) - WINDOW + 1, newest(step) + 1))
        force = np.array([force_n(cycle) for cycle in cycles])
        is_valid = np.array([valid(cycle) for cycle in cycles])
        assert np.array_equal(item["observation.skin.force"], force)
        assert np.array_equal(item["observation.skin.valid"], is_valid)
        seen_ns = item["observation.skin.sampled_ns"].numpy()
        assert np.abs(seen_ns - ClockedSkin.start_ns - cycles * PERIOD_NS).max() < 300
        age_ns = at_ns(step) - cycles * PERIOD_NS
        assert item["observation.skin.age"].numpy() == pytest.approx(age_ns * 1e-9, abs=1e-6)
        found |= dict(zip(cycles.tolist(), seen_ns.tolist(), strict=True))

        image = item["observation.images.skin"]
        assert image.shape == (3, 4 * WINDOW, 4)
        in_image_n, in_image = forces(image, WINDOW, 1.0)
        assert np.abs(in_image_n - force).max() <= 0.5 / 255 + 1e-6
        assert np.array_equal(in_image, is_valid)
    assert sorted(found) == list(range(newest(0) - WINDOW + 1, newest(STEPS - 1) + 1))
    assert len(found) == 6000


def as_uint8(image: np.ndarray) -> np.ndarray:
    return np.rint(np.moveaxis(np.asarray(image), 0, -1) * 255).astype(np.uint8)
