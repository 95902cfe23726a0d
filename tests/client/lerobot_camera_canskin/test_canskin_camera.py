"""The camera: found by LeRobot, connected to stand-ins for the services, read as LeRobot's robots read cameras."""

import logging

import numpy as np
import pytest

pytest.importorskip("lerobot", reason="NOT TESTED: the skin in LeRobot, for want of lerobot")

from lerobot.cameras import Camera, make_cameras_from_configs

from canskin.description import DESCRIPTION
from canskin.fabric import Fabric
from lerobot_camera_canskin import CanskinCamera, CanskinCameraConfig, forces
from tests.client.helpers import description
from tests.client.lerobot_camera_canskin.conftest import ClockedSkin, LiveChain, force_n, valid

MS_NS = 1_000_000


def camera_of(skin: ClockedSkin, **config: object) -> CanskinCamera:
    """Return a connected camera of a skin on the test's clock."""
    camera = CanskinCamera(CanskinCameraConfig(**config))
    camera.connect(warmup=False)
    return camera


def advance(skin: ClockedSkin, camera: CanskinCamera, to_ms: float) -> int:
    """Move the clock, and wait until the camera has all frames that have come."""
    cycle = skin.advance(int(to_ms * MS_NS))
    assert camera._buffer.wait_for(skin.hub.count, 20.0, np.inf)
    return cycle


def test_images_of_a_running_skin(live_chain: LiveChain) -> None:
    live_chain.start()
    config = CanskinCameraConfig(
        endpoint=live_chain.endpoint, window=3, force_max_n=20.0, max_age_ms=20_000, timeout_s=20.0
    )
    (camera,) = make_cameras_from_configs({"skin": config}).values()
    with camera:
        assert isinstance(camera, Camera)
        assert (camera.height, camera.width, camera.layout.name) == (12, 4, "palm")
        for image in (camera.read(), camera.async_read(timeout_ms=20_000), camera.read_latest(max_age_ms=20_000)):
            assert (image.shape, image.dtype) == ((12, 4, 3), np.uint8)
            force, is_valid = forces(image, 3, 20.0)
            assert np.abs(force[-1].ravel() - np.arange(16)).max() < 0.04
            assert is_valid[-1].all()
        assert camera.touch.age_s[-1] < 20
    assert not camera.is_connected


def test_full_scale_is_that_of_the_taxels_where_none_is_given(clocked: ClockedSkin) -> None:
    camera = camera_of(clocked)
    assert camera.force_max_n == 1.0
    cycle = advance(clocked, camera, 50)
    assert np.array_equal(camera.read_latest()[..., 1], np.rint(force_n(cycle) * 255))
    camera.disconnect()


def test_each_way_of_reading_has_the_frames_that_lerobot_expects(clocked: ClockedSkin) -> None:
    camera = camera_of(clocked, timeout_s=0.01)
    with pytest.raises(RuntimeError, match="no frame yet"):
        camera.read_latest()
    cycle = advance(clocked, camera, 50)
    camera.async_read()
    assert camera.touch.cycle.tolist() == [cycle]
    camera.read_latest()  # the same again
    assert camera.touch.cycle.tolist() == [cycle]
    for read in (camera.read, lambda: camera.async_read(timeout_ms=1)):  # both want a frame that was not read before
        with pytest.raises(TimeoutError, match=r"no new frame .*services present: gateway"):
            read()
    assert advance(clocked, camera, 60) == cycle + 1
    camera.async_read()
    assert camera.touch.cycle.tolist() == [cycle + 1]
    camera.disconnect()


def test_a_stale_skin_is_an_error_in_every_way_of_reading(clocked: ClockedSkin) -> None:
    camera = camera_of(clocked, max_age_ms=100, timeout_s=0.01)
    cycle = advance(clocked, camera, 62)
    assert cycle == 5
    clocked.now_ns = clocked.sampled_ns(5) + 101 * MS_NS  # and no frame comes any more
    for read in (camera.read, lambda: camera.async_read(timeout_ms=1), camera.read_latest):
        with pytest.raises(TimeoutError, match="the newest is 101 ms old"):
            read()
    camera.read_latest(max_age_ms=102)
    assert camera.touch.age_s == pytest.approx([0.101])
    camera.disconnect()


def test_taxels_that_were_not_measured_are_marked(clocked: ClockedSkin) -> None:
    camera = camera_of(clocked, window=2)
    clocked.silent.add(6)
    assert advance(clocked, camera, 82) == 7  # its odd taxels were not measured, and cycle 6 did not come
    _force, is_valid = forces(camera.read_latest(), 2, 1.0)
    assert not is_valid[0].any()
    assert np.array_equal(is_valid[1], valid(7))
    camera.disconnect()


def test_size_in_the_configuration_is_that_of_the_window(live_chain: LiveChain) -> None:
    config = CanskinCameraConfig(endpoint=live_chain.endpoint, window=2, height=4, width=4, timeout_s=20.0)
    camera = CanskinCamera(config)
    with pytest.raises(
        ValueError, match=r"'palm' has 4 x 4 taxels.*2 frames: expected height 8 and width 4, got 4 and 4"
    ):
        camera.connect()
    assert not camera.is_connected


@pytest.mark.parametrize(("window", "says"), [(3, "window=4 holds all"), (4, "")])
def test_a_window_that_loses_cycles_is_told(
    clocked: ClockedSkin, caplog: pytest.LogCaptureFixture, window: int, says: str
) -> None:
    with caplog.at_level(logging.WARNING):
        camera_of(clocked, window=window, fps=30).disconnect()
    assert says in caplog.text
    assert bool(says) == bool(caplog.text)


def test_silence_at_the_connection_says_what_is_there(live_chain: LiveChain) -> None:
    camera = CanskinCamera(CanskinCameraConfig(endpoint=live_chain.endpoint, timeout_s=1.0))
    with pytest.raises(ConnectionError, match=r"no 1 frames in 1 s, none came; services present: .*gateway"):
        camera.connect()
    assert not camera.is_connected


def test_an_absent_hub_is_named_and_has_no_cameras(endpoint: str) -> None:
    with pytest.raises(ConnectionError, match=rf"no hub at {endpoint}"):
        CanskinCamera(CanskinCameraConfig(endpoint=endpoint, timeout_s=0.2)).connect()
    assert CanskinCamera.find_cameras(endpoint) == []


def test_skins_of_a_hub_are_found_as_cameras(live_chain: LiveChain) -> None:
    second = Fabric("hand", "gateway", live_chain.endpoint)
    second.answer(DESCRIPTION, lambda _request, reply: reply(description()))
    found = CanskinCamera.find_cameras(live_chain.endpoint)
    assert [(each["name"], each["type"], each["id"]) for each in found] == [
        ("hand", "canskin", live_chain.endpoint),
        ("palm", "canskin", live_chain.endpoint),
    ]
    assert found[1]["default_stream_profile"] == {"width": 4, "height": 4, "fps": 100.0}
    second.close()


def test_calls_out_of_turn_are_refused(clocked: ClockedSkin) -> None:
    camera = CanskinCamera(CanskinCameraConfig())
    for call in (camera.read, camera.async_read, camera.read_latest, camera.disconnect, lambda: camera.layout):
        with pytest.raises(ConnectionError, match="not connected"):
            call()
    camera.connect(warmup=False)
    with pytest.raises(ConnectionError, match="already connected"):
        camera.connect()
    camera.disconnect()


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"window": 0}, "expected a window of 1 frame or more, got 0"),
        ({"force_max_n": 0.0}, "expected a force_max_n above 0 N, got 0.0"),
        ({"max_age_ms": 0}, "expected max_age_ms and timeout_s above 0"),
    ],
)
def test_values_that_cannot_be_used_are_refused(wrong: dict, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        CanskinCameraConfig(**wrong)
