"""The skin as a camera."""

import logging
import threading
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from lerobot.cameras import Camera
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

import canskin
from canskin.session import DEFAULT_ENDPOINT
from lerobot_camera_canskin.config_canskin_camera import CanskinCameraConfig
from lerobot_camera_canskin.window import TouchWindow, WindowBuffer

_log: Final = logging.getLogger(__name__)
#: Frames that wait for the thread that collects them.
_QUEUE: Final = 1000


class CanskinCamera(Camera):
    """A skin as a camera: an image is a window of the newest cycles, see `TouchWindow.image`.

    A window whose newest frame is older than allowed is an error. The image marks taxels and cycles that were not
    measured.

    Attributes
    ----------
    touch : TouchWindow or None
        The window of the image that was read last, with forces in newtons and times.

    Examples
    --------
    >>> with CanskinCamera(CanskinCameraConfig(window=4)) as camera:
    ...     print(camera.read().shape, camera.touch.force_n.max())
    """

    fps: int | None
    height: int | None
    width: int | None

    def __init__(self, config: CanskinCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self.touch: TouchWindow | None = None
        self._skin: canskin.Skin | None = None
        self._collecting: threading.Thread | None = None
        self._buffer: WindowBuffer | None = None
        self._force_max_n = config.force_max_n or 0.0

    def __str__(self) -> str:
        return f"{type(self).__name__}({self.config.skin or 'skin'} at {self.config.endpoint})"

    @property
    def is_connected(self) -> bool:
        """True between `connect` and `disconnect`; whether frames come is told by reading."""
        return self._skin is not None

    @property
    def layout(self) -> canskin.Description:
        """Geometry of the skin."""
        return self._open()[0].layout

    @property
    def force_max_n(self) -> float:
        """Force of one taxel, newtons, that is 255 in the image; 0 if it is not known before the connection."""
        return self._force_max_n

    @property
    def lost(self) -> int:
        """Cycles since the first image that were in no image, see `WindowBuffer`."""
        return 0 if self._buffer is None else self._buffer.lost

    @staticmethod
    def find_cameras(endpoint: str = DEFAULT_ENDPOINT) -> list[dict[str, Any]]:
        """Return the skins of a hub, as LeRobot describes cameras; none if no hub is there."""
        found = []
        try:
            for name in canskin.skins_at(endpoint):
                with canskin.connect(endpoint, name) as skin:
                    profile = {"width": skin.layout.columns, "height": skin.layout.rows, "fps": skin.layout.rate_hz}
                    found.append({"name": name, "type": "canskin", "id": endpoint, "default_stream_profile": profile})
        except canskin.BusError as error:
            _log.info("%s", error)
        return found

    @check_if_already_connected
    def connect(self, warmup: bool = True) -> None:
        """Connect to the skin; with `warmup`, wait for a whole window.

        Raises
        ------
        ConnectionError
            If the hub, the skin or its frames do not come in time; the message says what was looked for and found.
        ValueError
            If height or width of the configuration are not those of the window.
        """
        config = self.config
        try:
            skin = canskin.connect(config.endpoint, config.skin, timeout_s=config.timeout_s)
        except canskin.BusError as error:
            raise ConnectionError(f"{self}: {error}") from error
        try:
            self._fit(skin.layout)
        except ValueError:
            skin.close()
            raise
        self._buffer = buffer = WindowBuffer(config.window, skin.layout.rows, skin.layout.columns)
        self.touch, self._skin = None, skin
        frames = skin.frames(_QUEUE)
        self._collecting = threading.Thread(target=_collect, args=(frames, buffer), name=str(self), daemon=True)
        self._collecting.start()
        if warmup and not buffer.wait_for(config.window, config.timeout_s, config.max_age_ms * 1e-3):
            message = self._silence(f"no {config.window} frames in {config.timeout_s:g} s")
            self.disconnect()
            raise ConnectionError(message)

    @check_if_not_connected
    def read(self) -> npt.NDArray[np.uint8]:
        """Wait for the next frame, and return the window that ends with it.

        Raises
        ------
        TimeoutError
            If no frame comes in time.
        """
        _skin, buffer = self._open()
        return self._next(buffer.count + 1, self.config.timeout_s)

    @check_if_not_connected
    def async_read(self, timeout_ms: float = 200) -> npt.NDArray[np.uint8]:
        """Return the window that ends with the newest frame; wait for one if that was in an image before.

        Raises
        ------
        TimeoutError
            If no frame comes in time, or only old ones.
        """
        _skin, buffer = self._open()
        return self._next(buffer.used + 1, timeout_ms * 1e-3)

    @check_if_not_connected
    def read_latest(self, max_age_ms: int | None = None) -> npt.NDArray[np.uint8]:
        """Return the window that ends with the newest frame, at once.

        Raises
        ------
        RuntimeError
            If no frame came since the connection.
        TimeoutError
            If the newest frame is older than `max_age_ms`, without it those of the configuration.
        """
        _skin, buffer = self._open()
        if buffer.count == 0:
            raise RuntimeError(self._silence("no frame yet"))
        return self._image(self.config.max_age_ms if max_age_ms is None else max_age_ms)

    @check_if_not_connected
    def disconnect(self) -> None:
        """End the connection."""
        skin, _buffer = self._open()
        self._skin = None
        skin.close()
        if self._collecting is not None:
            self._collecting.join()

    def _fit(self, layout: canskin.Description) -> None:
        """Take what the configuration leaves to the skin, and check the rest."""
        window = self.config.window
        height, width = window * layout.rows, layout.columns
        if (self.height or height, self.width or width) != (height, width):
            raise ValueError(
                f"{self}: skin '{layout.name}' has {layout.rows} x {layout.columns} taxels, and the window {window}"
                f" frames: expected height {height} and width {width}, got {self.height} and {self.width}"
            )
        self.height, self.width = height, width
        self._force_max_n = self.config.force_max_n or layout.force_max_n
        if self.fps and layout.in_cycles and window * self.fps < layout.rate_hz:
            _log.warning(
                "%s: %d images/s of %d frames hold less than the skin's %g cycles/s: window=%d holds all",
                *(self, self.fps, window, layout.rate_hz, -(-layout.rate_hz // self.fps)),
            )

    def _open(self) -> tuple[canskin.Skin, WindowBuffer]:
        if self._skin is None or self._buffer is None:
            raise ConnectionError(f"{self} is not connected: call connect()")
        return self._skin, self._buffer

    def _next(self, count: int, timeout_s: float) -> npt.NDArray[np.uint8]:
        """Return the image of the newest window after `count` frames."""
        _skin, buffer = self._open()
        if not buffer.wait_for(count, timeout_s, self.config.max_age_ms * 1e-3):
            raise TimeoutError(self._silence(f"no new frame in {timeout_s * 1e3:g} ms"))
        return self._image(self.config.max_age_ms)

    def _image(self, max_age_ms: float) -> npt.NDArray[np.uint8]:
        _skin, buffer = self._open()
        touch = buffer.read(max_age_ms * 1e-3)
        if touch is None:
            raise TimeoutError(self._silence(f"no frame of the last {max_age_ms:g} ms"))
        self.touch = touch
        return touch.image(self._force_max_n)

    def _silence(self, what: str) -> str:
        skin, buffer = self._open()
        age_s, services = buffer.age_s, ", ".join(sorted(skin.health.services))
        newest = "none came" if age_s is None else f"the newest is {age_s * 1e3:.0f} ms old"
        return f"{self}: {what}, {newest}; services present: {services or 'none'}"


def _collect(frames: canskin.Frames, buffer: WindowBuffer) -> None:
    """Put frame after frame into the buffer until the skin is closed; readers see silence by the age of the newest."""
    while True:
        try:
            for frame in frames:
                buffer.put(frame)
        except canskin.BusError:
            continue
        return
