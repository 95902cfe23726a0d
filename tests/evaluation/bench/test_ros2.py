"""The way of an image to ROS 2."""

import pytest

from evaluation.bench.ros2 import run


@pytest.mark.slow
def test_every_image_arrives_and_is_equal() -> None:
    ((only, all_topics),) = run(1).values()
    for row in (only, all_topics):
        assert row["images"] == row["equal"] == 100
        assert 0 < row["median_ms"] <= row["p99_ms"]
