"""A skin in Foxglove (https://foxglove.dev): a server for the app, or a file (.mcap) for it."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from canskin.errors import RunError
from canskin.messages import Contact
from health.state import FRESH_S
from shell.extras import not_installed
from skin.layout import Layout
from skin.taxel_places import TAXEL_POINT, Forces, contact_place_m, radius_m, taxel_points, turned_to
from views.show.target import Address

IMAGE: Final = "/image"
TAXELS: Final = "/taxels"
CONTACTS: Final = "/contacts"
FIGURES: Final = "/figures"
LOG: Final = "/log"
_LEVELS: Final = {"info": "Info", "warning": "Warning", "error": "Error"}
_NS: Final = 1_000_000_000


class FoxgloveCanvas:
    """Draws into Foxglove's channels.

    Parameters
    ----------
    target : Address or pathlib.Path
        Serve the app there; port 0 takes a free one. Or write a file (.mcap).

    Attributes
    ----------
    address : str
        What the app connects to; empty for a file.

    Raises
    ------
    RunError
        If the server cannot listen there.
    """

    def __init__(self, layout: Layout, target: Address | Path) -> None:
        foxglove = _foxglove()
        self._messages, self._surface, self._frame = foxglove.messages, layout.taxels.surface, layout.name
        context, channels = foxglove.Context(), foxglove.channels
        self.address = ""
        try:
            if isinstance(target, Address):
                host = target.host.strip("[]")
                self._sink = foxglove.start_server(name=layout.name, host=host, port=target.port, context=context)
                self.address = f"ws://{target.host}:{self._sink.port}"
            else:
                self._sink = foxglove.open_mcap(target, context=context)
        except (RuntimeError, OSError) as error:
            where = f"{target.host}:{target.port}" if isinstance(target, Address) else target
            raise RunError(f"Foxglove: {where}: {error}") from error
        if self._surface.is_grid:
            self._image = channels.RawImageChannel(IMAGE, context=context)
            self._cells = channels.GridChannel(TAXELS, context=context)
        else:
            self._points = channels.PointCloudChannel(TAXELS, context=context)
        self._contacts = channels.SceneUpdateChannel(CONTACTS, context=context)
        self._log = channels.LogChannel(LOG, context=context)
        self._context, self._foxglove = context, foxglove
        self._figures: dict[str, Any] = {}

    def image(self, time_ns: int, cycle: int, measured_n: Forces) -> None:
        """Draw the forces: of a grid as an image in newtons and as cells in their places, else as points."""
        self.figure(time_ns, "cycle", cycle)
        draw = self._draw_grid if self._surface.is_grid else self._draw_points
        draw(time_ns, measured_n)

    def _draw_points(self, time_ns: int, measured_n: Forces) -> None:
        messages = self._messages
        numeric = messages.PackedElementFieldNumericType
        fields = [
            messages.PackedElementField(
                name=name, offset=offset, type=numeric.Float32 if kind.kind == "f" else numeric.Uint8
            )
            for name, (kind, offset, *_) in (TAXEL_POINT.fields or {}).items()
        ]
        cloud = messages.PointCloud(
            timestamp=self._stamp(time_ns),
            frame_id=self._frame,
            pose=self._pose((0.0, 0.0, 0.0)),
            point_stride=TAXEL_POINT.itemsize,
            fields=fields,
            data=taxel_points(self._surface, measured_n, ~np.isnan(measured_n)).tobytes(),
        )
        self._points.log(cloud, log_time=time_ns)

    def _draw_grid(self, time_ns: int, measured_n: Forces) -> None:
        messages, stamp = self._messages, self._stamp(time_ns)
        pixels = np.ascontiguousarray(measured_n, "<f4")
        rows, columns = pixels.shape
        self._image.log(
            messages.RawImage(
                timestamp=stamp,
                frame_id=self._frame,
                width=columns,
                height=rows,
                encoding="32FC1",
                step=4 * columns,
                data=pixels.tobytes(),
            ),
            log_time=time_ns,
        )
        pitch_m = self._surface.pitch_m
        force = messages.PackedElementField(name="force", offset=0, type=messages.PackedElementFieldNumericType.Float32)
        self._cells.log(
            messages.Grid(
                timestamp=stamp,
                frame_id=self._frame,
                pose=self._pose((-columns * pitch_m / 2, -rows * pitch_m / 2, 0.0)),
                column_count=columns,
                cell_size=messages.Vector2(x=pitch_m, y=pitch_m),
                row_stride=4 * columns,
                cell_stride=4,
                fields=[force],
                data=pixels.tobytes(),
            ),
            log_time=time_ns,
        )

    def contacts(self, time_ns: int, _cycle: int | None, contacts: Sequence[Contact]) -> None:
        """Draw a disc of each contact's area, an arrow against its normal, and its force in words.

        They are orange, and the words have a "?", where the contact is doubtful. All vanish after
        `health.state.FRESH_S`.
        """
        messages, surface = self._messages, self._surface
        pitch_m = surface.pitch_m
        places = [(each, np.array(contact_place_m(surface, each)), np.array(each.normal)) for each in contacts]

        def colour(contact: Contact, alpha: float) -> Any:
            red, green, blue = (1.0, 0.63, 0.0) if contact.doubtful else (1.0, 1.0, 1.0)
            return messages.Color(r=red, g=green, b=blue, a=alpha)

        entity = messages.SceneEntity(
            timestamp=self._stamp(time_ns),
            frame_id=self._frame,
            id="contacts",
            lifetime=messages.Duration(sec=0, nsec=round(FRESH_S * _NS)),
            cylinders=[
                messages.CylinderPrimitive(
                    pose=self._pose(place_m, turned_to(normal)),
                    size=messages.Vector3(
                        x=2 * radius_m(surface, each.taxels), y=2 * radius_m(surface, each.taxels), z=pitch_m / 4
                    ),
                    bottom_scale=1.0,
                    top_scale=1.0,
                    color=colour(each, 0.3),
                )
                for each, place_m, normal in places
            ],
            arrows=[
                messages.ArrowPrimitive(
                    pose=self._pose(place_m + 4 * pitch_m * normal, turned_to(-normal, axis=(1.0, 0.0, 0.0))),
                    shaft_length=3 * pitch_m,
                    shaft_diameter=pitch_m / 4,
                    head_length=pitch_m,
                    head_diameter=pitch_m / 2,
                    color=colour(each, 1.0),
                )
                for each, place_m, normal in places
            ],
            texts=[
                messages.TextPrimitive(
                    pose=self._pose(place_m + 4 * pitch_m * normal),
                    billboard=True,
                    font_size=4 * pitch_m,
                    scale_invariant=False,
                    color=colour(each, 1.0),
                    text=f"{each.identity}: {1e3 * each.force_n:.1f} mN{'?' * each.doubtful}",
                )
                for each, place_m, normal in places
            ],
        )
        self._contacts.log(messages.SceneUpdate(deletions=[], entities=[entity]), log_time=time_ns)

    def figure(self, time_ns: int, name: str, value: float) -> None:
        """Add a value to a curve: ``/figures/NAME.value``."""
        if name not in self._figures:
            schema = {"type": "object", "properties": {"value": {"type": "number"}}}
            self._figures[name] = self._foxglove.Channel(f"{FIGURES}/{name}", schema=schema, context=self._context)
        self._figures[name].log({"value": value}, log_time=time_ns)

    def line(self, time_ns: int, level: str, text: str) -> None:
        """Add a line to the log."""
        messages = self._messages
        line = messages.Log(
            timestamp=self._stamp(time_ns),
            level=getattr(messages.LogLevel, _LEVELS[level]),
            message=text,
            name="canskin",
        )
        self._log.log(line, log_time=time_ns)

    def close(self) -> None:
        """Write the end of the file, or stop the server."""
        if self.address:
            self._sink.stop()
        else:
            self._sink.close()

    def _stamp(self, time_ns: int) -> Any:
        return self._messages.Timestamp(sec=time_ns // _NS, nsec=time_ns % _NS)

    def _pose(self, place_m: Iterable[float], turn: Iterable[float] = (0.0, 0.0, 0.0, 1.0)) -> Any:
        messages = self._messages
        return messages.Pose(
            position=messages.Vector3(**dict(zip("xyz", map(float, place_m), strict=True))),
            orientation=messages.Quaternion(**dict(zip("xyzw", map(float, turn), strict=True))),
        )


def _foxglove() -> Any:
    """Return the library."""
    try:
        import foxglove
        import foxglove.channels
        import foxglove.messages
    except ImportError as error:
        raise not_installed("Foxglove needs foxglove-sdk", "foxglove") from error
    return foxglove
