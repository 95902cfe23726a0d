"""A skin in Rerun (https://rerun.io): the live viewer, or a file (.rrd) for it."""

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from canskin.errors import RunError
from canskin.messages import Contact
from shell.extras import not_installed
from skin.layout import Layout
from skin.plane import view_of
from skin.surface import Surface
from skin.taxel_places import Forces, contact_place_m, force_colours, radius_m, turned_to
from views.show.target import LOOPBACK

IMAGE: Final = "skin/image"
#: The image in colours: on a tensor Rerun gives taxels without a value the colour of the largest force.
HEAT_MAP: Final = "skin/heat_map"
TAXELS: Final = "skin/space/taxels"
CONTACTS: Final = "skin/space/contacts"
ARROWS: Final = "skin/space/arrows"
FIGURES: Final = "skin/figures"
LOG: Final = "skin/log"
#: Timelines: the sampling instant on the wall clock, and the number of the measurement.
SAMPLED: Final = "sampled"
CYCLE: Final = "cycle"
#: Length of the arrow of a contact, in pitches.
_ARROW: Final = 4.0
#: Port of a viewer that is started here: Rerun's own default.
PORT: Final = 9876
#: A viewer that runs answers within this time.
_ANSWER_S: Final = 5.0
_LEVELS: Final = {"info": "INFO", "warning": "WARN", "error": "ERROR"}


class RerunCanvas:
    """Draws into a recording stream of Rerun.

    Parameters
    ----------
    target : str or pathlib.Path, optional
        URL of a running viewer, ``rerun+http://HOST:9876/proxy``, or a new file (.rrd); default: start the viewer,
        which listens on loopback alone.

    Raises
    ------
    RunError
        If the viewer cannot be started, or does not answer.
    """

    def __init__(self, layout: Layout, target: str | Path | None = None) -> None:
        rr = _rerun()
        self._rr, self._taxels, self._surface = rr, layout.taxels, layout.taxels.surface
        self._stream = rr.RecordingStream("canskin")
        self._stream.set_log_time_enabled(enabled=False)
        blueprint = _blueprint(rr, layout)
        try:
            if isinstance(target, Path):
                self._stream.save(target, default_blueprint=blueprint)
            else:
                self._stream.connect_grpc(target or _start_viewer(), default_blueprint=blueprint)
                self._stream.flush(timeout_sec=_ANSWER_S)  # no viewer is no error before that
        except (RuntimeError, ValueError) as error:
            raise RunError(f"Rerun: {error}") from error
        half_m = self._surface.pitch_m / 2
        #: Squares of a grid, else discs.
        self._bodies = rr.Boxes3D if self._surface.is_grid else rr.Ellipsoids3D
        bodies = self._bodies(
            centers=self._surface.positions_m,
            half_sizes=np.tile(np.array([half_m, half_m, half_m / 10], np.float32), (layout.taxels.count, 1)),
            quaternions=turned_to(self._surface.normals),
            fill_mode="solid",
        )
        self._stream.log(TAXELS, bodies, static=True)

    def image(self, time_ns: int, cycle: int, measured_n: Forces) -> None:
        """Draw the forces: as a tensor in newtons, as the colours of the taxels and, of a grid, as a picture."""
        self._at(time_ns, cycle)
        full_n = self._taxels.force_max_n
        self._stream.log(IMAGE, self._rr.Tensor(measured_n, dim_names=("row", "column"), value_range=(0.0, full_n)))
        colours = force_colours(measured_n, full_n)
        if self._surface.is_grid:
            self._stream.log(HEAT_MAP, self._rr.Image(colours, magnification_filter="Nearest"))
        self._stream.log(TAXELS, self._bodies.from_fields(colors=colours.reshape(-1, 3)))

    def contacts(self, time_ns: int, cycle: int | None, contacts: Sequence[Contact]) -> None:
        """Draw a ring of each contact's area, with its force in words, and an arrow against its normal.

        They are orange, and the words have a "?", where the contact is doubtful.
        """
        self._at(time_ns, cycle)
        surface = self._surface
        normals = np.array([each.normal for each in contacts]).reshape(-1, 3)
        places_m = np.array([contact_place_m(surface, each) for each in contacts]).reshape(-1, 3)
        colours = [(255, 160, 0) if each.doubtful else (255, 255, 255) for each in contacts]
        rings = self._rr.Ellipsoids3D(
            centers=places_m + surface.pitch_m / 2 * normals,
            half_sizes=[(radius_m(surface, each.taxels),) * 2 + (surface.pitch_m / 20,) for each in contacts],
            quaternions=turned_to(normals),
            labels=[f"{each.identity}: {1e3 * each.force_n:.1f} mN{'?' * each.doubtful}" for each in contacts],
            colors=colours,
            fill_mode="majorwireframe",
            show_labels=True,
        )
        self._stream.log(CONTACTS, rings)
        pushes_m = -_ARROW * surface.pitch_m * normals
        arrows = self._rr.Arrows3D(vectors=pushes_m, origins=places_m - pushes_m, colors=colours)
        self._stream.log(ARROWS, arrows)

    def figure(self, time_ns: int, name: str, value: float) -> None:
        """Add a value to a curve."""
        self._at(time_ns)
        self._stream.log(f"{FIGURES}/{name}", self._rr.Scalars(value))

    def line(self, time_ns: int, level: str, text: str) -> None:
        """Add a line to the log."""
        self._at(time_ns)
        self._stream.log(LOG, self._rr.TextLog(text, level=_LEVELS[level]))

    def close(self) -> None:
        """Send what waits.

        Raises
        ------
        RunError
            If the viewer has gone, or the file cannot be written.
        """
        try:
            self._stream.flush()
        except RuntimeError as error:
            raise RunError(f"Rerun: {error}") from error
        finally:
            self._stream.disconnect()

    def _at(self, time_ns: int, cycle: int | None = None) -> None:
        self._stream.reset_time()
        self._stream.set_time(SAMPLED, timestamp=np.datetime64(time_ns, "ns"))
        if cycle is not None:
            self._stream.set_time(CYCLE, sequence=cycle)


def _blueprint(rr: Any, layout: Layout) -> Any:
    """Return the arrangement of the views; pixels are not interpolated."""
    rrb, surface = rr.blueprint, layout.taxels.surface
    middle = _eye(rrb, surface)
    shown = rrb.TensorScalarMapping(mag_filter="Nearest", colormap="viridis")
    pictures = rrb.Tabs(
        rrb.Spatial2DView(origin=HEAT_MAP, name="image"),
        rrb.TensorView(origin=IMAGE, name="newtons", scalar_mapping=shown),
        active_tab="image",
    )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                *([pictures] if surface.is_grid else []),
                rrb.Spatial3DView(origin="skin/space", name="taxels and contacts", eye_controls=middle),
            ),
            rrb.Horizontal(
                rrb.TimeSeriesView(origin=f"{FIGURES}/load", name="bus load"),
                rrb.TimeSeriesView(
                    name="valid share, label",
                    contents=[f"{FIGURES}/valid_share", f"{FIGURES}/label_confidence"],
                ),
                rrb.TimeSeriesView(origin=f"{FIGURES}/force_n", name="force, N"),
                rrb.TextLogView(origin=LOG, name="log"),
            ),
            row_shares=[2, 1],
        ),
        collapse_panels=True,
    )


def _eye(rrb: Any, surface: Surface) -> Any:
    """Return a viewer in front of the middle of the skin, who sees all of it."""
    middle_m = surface.positions_m.mean(axis=0)
    _, down, away = view_of(surface)
    size_m = float(np.ptp(surface.positions_m, axis=0).max()) + surface.pitch_m
    return rrb.EyeControls3D(position=middle_m - 1.2 * size_m * away, look_target=middle_m, eye_up=-down)


def _start_viewer() -> str:
    """Start a viewer on loopback, unless a program listens on `PORT`; return its URL.

    Rerun's own `spawn` would listen on every network, and looks for the program in PATH alone.
    """
    import rerun_bindings
    import rerun_cli

    program = files(rerun_cli) / "rerun"
    rerun_bindings.spawn(
        port=PORT,
        executable_path=str(program) if program.is_file() else None,  # of macOS the package has another
        extra_args=["--bind", LOOPBACK],
        extra_env=[("RERUN_APP_ONLY", "true")],
    )
    return f"rerun+http://{LOOPBACK}:{PORT}/proxy"


def _rerun() -> Any:
    """Return the library."""
    try:
        import rerun
        import rerun.blueprint
    except ImportError as error:
        raise not_installed("Rerun needs rerun-sdk", "rerun") from error
    return rerun
