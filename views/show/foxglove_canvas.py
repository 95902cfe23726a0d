"""A skin in Foxglove (https://foxglove.dev): a server for the app, or a file (.mcap) for it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from canskin.errors import RunError
from canskin.messages import Contact
from health.state import FRESH_S
from shell.extras import not_installed
from skin.layout import Layout
from skin.taxel_places import Forces, place_m, radius_m
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
        self._messages, self._taxels, self._frame = foxglove.messages, layout.taxels, layout.name
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
        self._image = channels.RawImageChannel(IMAGE, context=context)
        self._grid = channels.GridChannel(TAXELS, context=context)
        self._contacts = channels.SceneUpdateChannel(CONTACTS, context=context)
        self._log = channels.LogChannel(LOG, context=context)
        self._context, self._foxglove = context, foxglove
        self._figures: dict[str, Any] = {}

    def image(self, time_ns: int, _cycle: int, measured_n: Forces) -> None:
        """Draw the forces: as an image in newtons, and as cells in their places."""
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
        pitch_m = self._taxels.pitch_m
        force = messages.PackedElementField(name="force", offset=0, type=messages.PackedElementFieldNumericType.Float32)
        self._grid.log(
            messages.Grid(
                timestamp=stamp,
                frame_id=self._frame,
                pose=self._pose(-columns * pitch_m / 2, -rows * pitch_m / 2),
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
        """Draw a disc of each contact's area, and its force in words; orange and with a "?" where it is doubtful.

        All vanish after `health.state.FRESH_S`.
        """
        messages, taxels = self._messages, self._taxels

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
                    pose=self._pose(*place_m(taxels, each.row, each.column)),
                    size=messages.Vector3(
                        x=2 * radius_m(taxels, each.taxels), y=2 * radius_m(taxels, each.taxels), z=taxels.pitch_m / 4
                    ),
                    bottom_scale=1.0,
                    top_scale=1.0,
                    color=colour(each, 0.3),
                )
                for each in contacts
            ],
            texts=[
                messages.TextPrimitive(
                    pose=self._pose(*place_m(taxels, each.row, each.column), -4 * taxels.pitch_m),
                    billboard=True,
                    font_size=4 * taxels.pitch_m,
                    scale_invariant=False,
                    color=colour(each, 1.0),
                    text=f"{each.identity}: {1e3 * each.force_n:.1f} mN{'?' * each.doubtful}",
                )
                for each in contacts
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

    def _pose(self, x_m: float, y_m: float, z_m: float = 0.0) -> Any:
        messages = self._messages
        return messages.Pose(
            position=messages.Vector3(x=x_m, y=y_m, z=z_m), orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
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
