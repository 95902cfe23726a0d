"""A skin in Rerun (https://rerun.io): the live viewer, or a file (.rrd) for it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from canskin.errors import RunError
from canskin.messages import Contact
from shell.extras import not_installed
from skin.layout import Layout
from skin.taxel_places import Forces, force_colours, place_m, places_m, radius_m

IMAGE: Final = "skin/image"
#: The image in colours: on a tensor Rerun gives taxels without a value the colour of the largest force.
HEAT_MAP: Final = "skin/heat_map"
TAXELS: Final = "skin/space/taxels"
CONTACTS: Final = "skin/space/contacts"
FIGURES: Final = "skin/figures"
LOG: Final = "skin/log"
#: Timelines: the sampling instant on the wall clock, and the number of the measurement.
SAMPLED: Final = "sampled"
CYCLE: Final = "cycle"
#: A viewer that runs answers within this time.
_ANSWER_S: Final = 5.0
_LEVELS: Final = {"info": "INFO", "warning": "WARN", "error": "ERROR"}


class RerunCanvas:
    """Draws into a recording stream of Rerun.

    Parameters
    ----------
    target : str or pathlib.Path, optional
        URL of a running viewer, ``rerun+http://HOST:9876/proxy``, or a new file (.rrd); default: start the viewer.

    Raises
    ------
    RunError
        If the viewer cannot be started, or does not answer.
    """

    def __init__(self, layout: Layout, target: str | Path | None = None) -> None:
        rr = _rerun()
        self._rr, self._taxels = rr, layout.taxels
        self._stream = rr.RecordingStream("canskin")
        self._stream.set_log_time_enabled(enabled=False)
        blueprint = _blueprint(rr, layout)
        try:
            if target is None:
                self._stream.spawn(default_blueprint=blueprint)
            elif isinstance(target, Path):
                self._stream.save(target, default_blueprint=blueprint)
            else:
                self._stream.connect_grpc(target, default_blueprint=blueprint)
                self._stream.flush(timeout_sec=_ANSWER_S)  # no viewer is no error before that
        except (RuntimeError, ValueError) as error:
            raise RunError(f"Rerun: {error}") from error
        half_m = layout.taxels.pitch_m / 2
        squares = rr.Boxes3D(
            centers=places_m(layout.taxels),
            half_sizes=np.tile(np.array([half_m, half_m, half_m / 10], np.float32), (layout.taxels.count, 1)),
            fill_mode="solid",
        )
        self._stream.log(TAXELS, squares, static=True)

    def image(self, time_ns: int, cycle: int, measured_n: Forces) -> None:
        """Draw the forces: as a tensor in newtons, as a picture, and as the colours of the taxels."""
        self._at(time_ns, cycle)
        full_n = self._taxels.force_max_n
        self._stream.log(IMAGE, self._rr.Tensor(measured_n, dim_names=("row", "column"), value_range=(0.0, full_n)))
        colours = force_colours(measured_n, full_n)
        self._stream.log(HEAT_MAP, self._rr.Image(colours, magnification_filter="Nearest"))
        self._stream.log(TAXELS, self._rr.Boxes3D.from_fields(colors=colours.reshape(-1, 3)))

    def contacts(self, time_ns: int, cycle: int | None, contacts: Sequence[Contact]) -> None:
        """Draw a ring of each contact's area, with its force in words; orange and with a "?" where it is doubtful."""
        self._at(time_ns, cycle)
        taxels = self._taxels
        above_m = -taxels.pitch_m / 2
        self._stream.log(
            CONTACTS,
            self._rr.Ellipsoids3D(
                centers=[(*place_m(taxels, each.row, each.column), above_m) for each in contacts],
                half_sizes=[(radius_m(taxels, each.taxels),) * 2 + (taxels.pitch_m / 20,) for each in contacts],
                labels=[f"{each.identity}: {1e3 * each.force_n:.1f} mN{'?' * each.doubtful}" for each in contacts],
                colors=[(255, 160, 0) if each.doubtful else (255, 255, 255) for each in contacts],
                fill_mode="majorwireframe",
                show_labels=True,
            ),
        )

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
    rrb = rr.blueprint
    middle = rrb.EyeControls3D(
        position=(0.0, 0.0, -1.2 * layout.taxels.rows * layout.taxels.pitch_m),
        look_target=(0.0, 0.0, 0.0),
        eye_up=(0.0, -1.0, 0.0),
    )
    shown = rrb.TensorScalarMapping(mag_filter="Nearest", colormap="viridis")
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                rrb.Tabs(
                    rrb.Spatial2DView(origin=HEAT_MAP, name="image"),
                    rrb.TensorView(origin=IMAGE, name="newtons", scalar_mapping=shown),
                    active_tab="image",
                ),
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


def _rerun() -> Any:
    """Return the library."""
    try:
        import rerun
        import rerun.blueprint
    except ImportError as error:
        raise not_installed("Rerun needs rerun-sdk", "rerun") from error
    return rerun
