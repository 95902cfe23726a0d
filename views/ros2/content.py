"""What a skin measures as messages of ROS 2: images, clouds of points, markers."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.messages import Contact
from health.state import FRESH_S
from skin.layout import Taxels
from skin.surface import Surface
from skin.taxel_places import Forces, contact_place_m, force_colours, radius_m, taxel_points, turned_to
from views.ros2.types import IMAGE, MARKERS, POINT_CLOUD, TEXT, WRENCH, message

NS: Final = 1_000_000_000
#: `sensor_msgs/msg/PointField`: the number of a type.
_FIELD_TYPES: Final = {"u1": 2, "u4": 6, "f4": 7}

#: Points of a cloud of contacts: newtons, metres, seconds, numbers of taxels; `doubtful` is 1 for what may be an error
#: of the zero, else 0.
CONTACT_POINT: Final = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "normal_x", "normal_y", "normal_z", "force", "peak", "age")),
        *((name, "<u4") for name in ("identity", "taxels", "invalid_taxels", "doubtful")),
    ]
)


def header(time_ns: int, frame: str) -> Any:
    """Return a header with a time of the wall clock."""
    stamp = message("builtin_interfaces/msg/Time", sec=time_ns // NS, nanosec=time_ns % NS)
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def force_image(head: Any, measured_n: Forces) -> Any:
    """Return an image of forces: 32FC1, newtons, NaN where not measured."""
    return _image(head, "32FC1", np.ascontiguousarray(measured_n, "<f4"))


def heat_map(head: Any, measured_n: Forces, full_n: float) -> Any:
    """Return a coloured image: rgb8, viridis from 0 to `full_n`, grey where not measured."""
    return _image(head, "rgb8", force_colours(measured_n, full_n))


def taxel_cloud(head: Any, surface: Surface, forces_n: Forces, valid: npt.NDArray[np.bool_]) -> Any:
    """Return the taxels as a cloud, with rows and columns of a grid, else one row; see `skin.taxel_places`."""
    return _cloud(head, taxel_points(surface, forces_n, valid))


def contact_cloud(head: Any, surface: Surface, contacts: Sequence[Contact], sampled_mono_ns: int) -> Any:
    """Return a point for each contact, at its centre of force, the strongest first; points are of `CONTACT_POINT`."""
    points = np.zeros((1, len(contacts)), CONTACT_POINT)
    places = [(*contact_place_m(surface, each), *each.normal) for each in contacts]
    for name, column in zip(CONTACT_POINT.names or (), np.reshape(places, (-1, 6)).T, strict=False):
        points[name] = column
    points["age"] = [(sampled_mono_ns - each.onset_mono_ns) * 1e-9 for each in contacts]
    points["force"] = [each.force_n for each in contacts]
    points["peak"] = [each.peak_n for each in contacts]
    for name in ("identity", "taxels", "invalid_taxels", "doubtful"):
        points[name] = [getattr(each, name) for each in contacts]
    return _cloud(head, points)


def contact_markers(head: Any, taxels: Taxels, contacts: Sequence[Contact]) -> Any:
    """Return what RViz draws: a disc of each contact's area, and its force in words, with a "?" where it is doubtful.

    Markers drawn before go; without new ones all go after `health.state.FRESH_S`.
    """
    made, surface = [_marker(head, "", 0, action=3)], taxels.surface
    pitch_m = surface.pitch_m
    for each in contacts:
        place = np.array(contact_place_m(surface, each))
        width_m = 2 * radius_m(surface, each.taxels)
        parts = force_colours(np.array(each.peak_n, np.float32)[None], taxels.force_max_n)[0] / 255
        colour = (*map(float, parts), 0.8)
        number = each.identity % 2**31
        disc = {"size": (width_m, width_m, pitch_m / 4), "turn": turned_to(each.normal).tolist()}
        made.append(_marker(head, "contacts", number, kind=3, place=place.tolist(), colour=colour, **disc))
        above, height = (place + 4 * pitch_m * np.array(each.normal)).tolist(), (0.0, 0.0, 4 * pitch_m)
        words = f"{1e3 * each.force_n:.1f} mN{'?' * each.doubtful}"
        made.append(_marker(head, "forces", number, kind=9, place=above, size=height, text=words))
    return message(MARKERS, markers=made)


def wrench(head: Any, surface: Surface, forces_n: Forces, taxels: npt.NDArray[np.bool_]) -> Any:
    """Return force (N) against the normals, and torque (Nm) about the frame's origin, of some taxels, shape (n,)."""
    pushes_n = -forces_n.ravel()[taxels, None] * surface.normals[taxels]
    torques_nm = np.cross(surface.positions_m[taxels], pushes_n)
    force, torque = (
        message(
            "geometry_msgs/msg/Vector3", **dict(zip("xyz", each.sum(axis=0, dtype=np.float64).tolist(), strict=True))
        )
        for each in (pushes_n, torques_nm)
    )
    return message(WRENCH, header=head, wrench=message("geometry_msgs/msg/Wrench", force=force, torque=torque))


def text(words: str) -> Any:
    """Return a text."""
    return message(TEXT, data=words)


def _image(head: Any, encoding: str, pixels: npt.NDArray[Any]) -> Any:
    return message(
        IMAGE,
        header=head,
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=pixels[0].nbytes,
        data=pixels.reshape(-1).view(np.uint8),
    )


def _cloud(head: Any, points: npt.NDArray[Any]) -> Any:
    fields = {name: points.dtype[name].str[1:] for name in points.dtype.names or ()}
    offsets = {name: place[1] for name, place in (points.dtype.fields or {}).items()}
    return message(
        POINT_CLOUD,
        header=head,
        height=points.shape[0],
        width=points.shape[1],
        fields=[
            message("sensor_msgs/msg/PointField", name=name, offset=offsets[name], datatype=_FIELD_TYPES[kind], count=1)
            for name, kind in fields.items()
        ],
        is_bigendian=False,
        point_step=points.itemsize,
        row_step=points.itemsize * points.shape[1],
        data=np.frombuffer(points.tobytes(), np.uint8),
        is_dense=True,
    )


def _marker(
    head: Any,
    group: str,
    number: int,
    *,
    kind: int = 0,
    action: int = 0,
    place: Sequence[float] = (0.0, 0.0, 0.0),
    turn: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
    size: tuple[float, float, float] = (0.0, 0.0, 0.0),
    colour: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0),
    text: str = "",
) -> Any:
    """Return a marker; kind and action are numbers of `visualization_msgs/msg/Marker`."""
    nothing = np.zeros(0, np.uint8)
    return message(
        "visualization_msgs/msg/Marker",
        header=head,
        ns=group,
        id=number,
        type=kind,
        action=action,
        pose=message(
            "geometry_msgs/msg/Pose",
            position=message("geometry_msgs/msg/Point", **dict(zip("xyz", place, strict=True))),
            orientation=message("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", turn, strict=True))),
        ),
        scale=message("geometry_msgs/msg/Vector3", **dict(zip("xyz", size, strict=True))),
        color=message("std_msgs/msg/ColorRGBA", **dict(zip("rgba", colour, strict=True))),
        lifetime=message("builtin_interfaces/msg/Duration", sec=0, nanosec=round(FRESH_S * NS)),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=message("sensor_msgs/msg/CompressedImage", header=head, format="", data=nothing),
        uv_coordinates=[],
        text=text,
        mesh_resource="",
        mesh_file=message("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        mesh_use_embedded_materials=False,
    )
