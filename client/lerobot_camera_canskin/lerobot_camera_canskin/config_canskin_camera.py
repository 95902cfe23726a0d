"""Configuration of the skin as a camera."""

from dataclasses import dataclass

from lerobot.cameras import CameraConfig

from canskin.session import DEFAULT_ENDPOINT


@CameraConfig.register_subclass("canskin")
@dataclass(kw_only=True)
class CanskinCameraConfig(CameraConfig):
    """A skin as a camera: ``type: canskin``.

    LeRobot's robots want ``height``, ``width`` and ``fps`` of every camera: `window` x rows of the skin, columns of the
    skin, policy steps per second. Without a robot, all three may be left out.

    Attributes
    ----------
    endpoint : str
        Address of the skin's hub; ``skin gateway`` and ``skin demo`` print it.
    skin : str, optional
        Name of the skin; needed where a hub has several.
    window : int
        Number of cycles in one image, the oldest on top. No cycle is lost if `window` is at least the rate of the skin
        divided by `fps`.
    force_max_n : float, optional
        Force of one taxel, newtons, that is 255 in the image. Default: the largest force that a taxel measures.
    max_age_ms : int
        A window whose newest frame is older is an error, never an image.
    timeout_s : float
        Longest wait of ``connect`` and ``read`` for the skin.

    Raises
    ------
    ValueError
        If a value cannot be used.
    """

    endpoint: str = DEFAULT_ENDPOINT
    skin: str | None = None
    window: int = 1
    force_max_n: float | None = None
    max_age_ms: int = 500
    timeout_s: float = 5.0

    def __post_init__(self) -> None:
        if self.window < 1:
            raise ValueError(f"expected a window of 1 frame or more, got {self.window}")
        if self.force_max_n is not None and not self.force_max_n > 0:
            raise ValueError(f"expected a force_max_n above 0 N, got {self.force_max_n}")
        if self.max_age_ms <= 0 or self.timeout_s <= 0:
            raise ValueError(
                f"expected max_age_ms and timeout_s above 0, got {self.max_age_ms} ms and {self.timeout_s} s"
            )
