"""The images of a recording as a video in real time."""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, NamedTuple, Self

import numpy as np

from canskin.errors import InputError, RunError
from canskin.messages import CONTACTS, IMAGE, LABEL, Contacts, Image, Label
from health.state import FRESH_S
from recording.drawing import Drawing, Picture
from recording.mcap_file import Warn, read_messages
from shell.extras import not_installed
from shell.output import replacing
from skin.layout import Layout

if TYPE_CHECKING:
    from av import VideoFrame

#: The scale of colours ends at this part of the range or above: below, colours would show noise alone.
LEAST_TOP: Final = 0.25
#: Unit of the times in the file.
TICK_S: Final = Fraction(1, 90_000)
_CODEC: Final = "libx264"
#: Constant quality whose losses are not seen; without B frames, in whose order MP4 would have other times.
_QUALITY: Final = {"crf": "16", "preset": "superfast", "bf": "0"}
#: Colours as players expect those of small videos: ITU-R BT.601, limited range.
_BT601: Final = "ITU601"
_BT601_CODE: Final = 6


class VideoResult(NamedTuple):
    """What a video shows.

    Attributes
    ----------
    images, gaps : int
        Number of images, and of times without images.
    seconds : float
        Length of the video.
    top_n : float
        Top of the colour scale, newtons.
    """

    images: int
    gaps: int
    seconds: float
    top_n: float


class _Read(NamedTuple):
    """What is known before the first picture: messages by cycle and sampling instant, and the largest force."""

    contacts: Mapping[tuple[int, int], Contacts]
    labels: Mapping[tuple[int, int], Label]
    peak_n: float


def save_video(path: Path, source: Path, layout: Layout, warn: Warn) -> VideoResult:
    """Write the images of a recording as H.264 in MP4: each is shown from its sampling instant to that of the next.

    Half a second after the last image before a gap the picture is grey and says how long there is no image, as the
    page does.

    Raises
    ------
    RunError
        If the recording has no images.
    OSError
        If the file cannot be written.
    """
    require_libraries()
    known = _read(source, layout, warn)
    top_n = max(known.peak_n, LEAST_TOP * layout.taxels.force_max_n)
    drawing = Drawing(layout, top_n)
    images = gaps = 0
    time_s = 0.0
    with replacing(path) as file, Video(file, drawing) as video:
        for picture, time_s, is_image in _pictures(source, drawing, known):
            video.add(picture, time_s)
            images, gaps = images + is_image, gaps + (not is_image)
        video.end(time_s + layout.sync.period_s)
    return VideoResult(images, gaps, time_s + layout.sync.period_s, top_n)


def require_libraries() -> None:
    """Check that the extra is installed."""
    try:
        import av
        import PIL.Image  # noqa: F401
    except ImportError as error:
        raise not_installed("--to video needs PyAV and Pillow", "video") from error
    if _CODEC not in av.codecs_available:
        raise InputError(f"--to video: this build of PyAV has no {_CODEC}: install PyAV from its wheels")


def _read(source: Path, layout: Layout, warn: Warn) -> _Read:
    """Read all but the pixels."""
    topics = CONTACTS, LABEL, IMAGE
    known: dict[str, dict[tuple[int, int], Any]] = {topic.name: {} for topic in topics}
    peak_n, images = 0.0, 0
    for topic, _, message in read_messages(source, topics, warn):
        if topic is not IMAGE:
            known[topic.name][message.cycle, message.sampled_mono_ns] = message
            continue
        if (len(message.pixels), len(message.valid)) != (4 * layout.taxels.count, layout.blocks):
            raise InputError(f"{source}: an image does not fit the layout '{layout.name}'")
        images += 1
        peak_n = max(peak_n, float(np.frombuffer(message.pixels, "<f4").max()))
    if not images:
        raise RunError(f"{source}: holds no images: make them with 'skin replay {source.name} --out NEW.mcap'")
    return _Read(known[CONTACTS.name], known[LABEL.name], peak_n)


def _images(source: Path) -> Iterator[Image]:
    """Yield the images, each later than the image before."""
    newest_ns = -1
    for read in read_messages(source, [IMAGE], lambda _: None):
        image: Image = read.message
        if image.sampled_mono_ns > newest_ns:
            newest_ns = image.sampled_mono_ns
            yield image


def _pictures(source: Path, drawing: Drawing, known: _Read) -> Iterator[tuple[Picture, float, bool]]:
    """Yield pictures, the seconds since the first at which each begins, and whether it is an image or a gap."""
    first_ns: int | None = None
    time_s, before = 0.0, None
    for image in _images(source):
        first_ns = image.sampled_mono_ns if first_ns is None else first_ns
        gap_s = (image.sampled_mono_ns - first_ns) * 1e-9 - time_s
        if before is not None and gap_s > FRESH_S:
            yield drawing.old(before, f"no image for {gap_s:.2f} s"), time_s + FRESH_S, False
        time_s += gap_s
        key = image.cycle, image.sampled_mono_ns
        found, label = known.contacts.get(key), known.labels.get(key)
        before = drawing.draw(
            np.frombuffer(image.pixels, "<f4").reshape(drawing.shape),
            np.frombuffer(image.valid, np.uint8) != 0,
            found.contacts if found is not None and not found.blind else (),
            f"{time_s:.2f} s   cycle {image.cycle}   {label.label if label is not None else ''}",
        )
        yield before, time_s, True


class Video:
    """A file with pictures that begin at given times.

    Parameters
    ----------
    drawing : Drawing
        Gives the size of the pictures.
    """

    def __init__(self, file: BinaryIO, drawing: Drawing) -> None:
        import av

        self._container = av.open(file, "w", format="mp4")
        self._stream = self._container.add_stream(_CODEC, rate=round(1 / TICK_S), options=dict(_QUALITY))
        self._stream.width, self._stream.height, self._stream.pix_fmt = drawing.width, drawing.height, "yuv420p"
        self._stream.time_base = self._stream.codec_context.time_base = TICK_S
        self._stream.codec_context.colorspace = _BT601_CODE
        self._newest: tuple[Picture, int] | None = None
        self._durations: dict[int, int] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._container.close()

    def add(self, picture: Picture, time_s: float) -> None:
        """Show a picture from a time until the next picture."""
        tick = round(time_s / TICK_S)
        self._show(tick)
        self._newest = picture, tick

    def end(self, time_s: float) -> None:
        """Show the last picture until a time, and end the video."""
        self._show(round(time_s / TICK_S))
        self._write(None)

    def _show(self, until: int) -> None:
        """Write the newest picture, which ends now."""
        if self._newest is None:
            return
        import av

        picture, tick = self._newest
        frame = av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="yuv420p", dst_colorspace=_BT601)
        frame.pts, frame.time_base = tick, TICK_S
        self._durations[tick] = until - tick
        self._write(frame)

    def _write(self, frame: "VideoFrame | None") -> None:
        for packet in self._stream.encode(frame):
            if packet.pts is not None:
                packet.duration = self._durations.pop(packet.pts)
            self._container.mux(packet)
