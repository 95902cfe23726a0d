"""Files with a calibration: JSON with the fingerprint of the skin that it belongs to."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Final

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.errors import UNDECODABLE, InputError, tell
from canskin.messages import MEASUREMENT, Measurement
from recording import is_recording
from skin.defects import SumGains
from skin.layout import Layout
from skin.limits import check_bytes, read_file
from skin.measured_sums import check_measurement

#: No gain is stored that is not between these.
LEAST_GAIN, MOST_GAIN = 0.01, 100.0
#: Of files: 2 can hold gains of sums.
VERSION: Final = 2
#: Most bytes of a file: all lists of 2**16 taxels fit.
BYTES_MAX: Final = 6 * 2**20

Floats = npt.NDArray[np.float64]
_Gain = Annotated[float, msgspec.Meta(ge=LEAST_GAIN, le=MOST_GAIN)]


class StoredCalibration(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is known of a skin's sums and taxels; parts that are not known are empty.

    Attributes
    ----------
    skin, fingerprint, force_max_n
        Name of the layout, fingerprint of its Φ, and end of its taxels' range in newtons.
    saved : str
        When, in UTC.
    offsets_n : list of float or None
        Of each sum, newtons; None for unknown ones.
    gains : list of float
        Reading / force of each taxel, row-major.
    taxel_offsets_n : list of float
        Of each taxel, row-major, newtons: for nodes.
    defects : list of str
        In words.
    differential_gains, common_mode_gains : list of float
        Of each analogue sum, see `skin.defects.SumGains`.
    version : int
        Of the file; files without it are of version 1.
    """

    skin: str
    fingerprint: str
    force_max_n: float
    saved: str = ""
    offsets_n: list[float | None] = []
    gains: list[_Gain] = []
    taxel_offsets_n: list[float] = []
    defects: list[str] = []
    differential_gains: list[_Gain] = []
    common_mode_gains: list[float] = []
    version: int = 1

    def sum_gains(self) -> SumGains | None:
        """Return the gains of the sums; None without any."""
        if not self.differential_gains:
            return None
        return SumGains(np.array(self.differential_gains), np.array(self.common_mode_gains))

    def sum_offsets_n(self) -> Floats | None:
        """Return the offsets of the sums, shape (m,), NaN for unknown ones; None without any."""
        return np.array(self.offsets_n, np.float64) if self.offsets_n else None

    def required_offsets_n(self, origin: str) -> Floats:
        """Return the offsets of the sums; `origin` names the calibration in the message."""
        offsets_n = self.sum_offsets_n()
        if offsets_n is None:
            raise InputError(
                f"{origin}: has no offsets of sums: gains are used by nodes, with 'skin calibration load --to-nodes'"
            )
        return offsets_n


class _Version(msgspec.Struct, frozen=True):
    """The version of a file of any version."""

    version: int = 1


def new_calibration(
    layout: Layout,
    *,
    offsets_n: Floats | None = None,
    gains: Floats | None = None,
    sum_gains: SumGains | None = None,
    defects: list[str] | None = None,
) -> StoredCalibration:
    """Return a calibration of a skin, made now."""
    return StoredCalibration(
        skin=layout.name,
        fingerprint=layout.phi().fingerprint,
        force_max_n=layout.taxels.force_max_n,
        saved=datetime.now(UTC).isoformat(timespec="seconds"),
        offsets_n=[] if offsets_n is None else _or_none(offsets_n),
        gains=[] if gains is None else np.clip(gains, LEAST_GAIN, MOST_GAIN).tolist(),
        defects=defects or [],
        differential_gains=[] if sum_gains is None else np.clip(sum_gains.differential, LEAST_GAIN, MOST_GAIN).tolist(),
        common_mode_gains=[] if sum_gains is None else np.clip(sum_gains.common_mode, -MOST_GAIN, MOST_GAIN).tolist(),
        version=1 if sum_gains is None else VERSION,
    )


def _or_none(values: Floats) -> list[float | None]:
    """Return values as JSON has them: None for NaN."""
    listed: list[float | None] = values.tolist()
    for each in np.flatnonzero(~np.isfinite(values)).tolist():
        listed[each] = None
    return listed


def encoded(stored: StoredCalibration) -> bytes:
    """Return the content of a file."""
    return msgspec.json.encode(stored) + b"\n"


def most_offset_n(layout: Layout) -> float:
    """Return the largest offset that a sum can have, newtons."""
    return layout.phi().block_size * layout.taxels.force_max_n


def load_calibration(path: Path, layout: Layout, *, is_shown: bool = False) -> StoredCalibration:
    """Read a file, or the calibration of a recording; to be shown, with offsets beyond `most_offset_n`, too."""
    if is_recording(path):
        return _recorded(path, layout, is_shown=is_shown)
    content = read_file(path, InputError, "the calibration", BYTES_MAX)
    return parse_calibration(content, layout, str(path), is_shown=is_shown)


def _recorded(path: Path, layout: Layout, *, is_shown: bool) -> StoredCalibration:
    """Return the calibration that is attached to a recording, with the newest offsets of its measurements."""
    from recording.mcap_file import CALIBRATION_FILE, newest_file, read_messages  # no service waits for it

    content = newest_file(path, CALIBRATION_FILE)
    attached = None if content is None else parse_calibration(content, layout, str(path), is_shown=is_shown)
    newest: Measurement | None = None
    for read in read_messages(path, [MEASUREMENT], lambda line: tell("calibration", line)):
        newest = read.message
    if newest is None or not newest.offsets:
        if attached is None:
            raise InputError(f"{path}: the recorded gateway had no calibration")
        return attached
    check_measurement(newest, layout.phi(), Measurement)
    found = new_calibration(layout, offsets_n=np.frombuffer(newest.offsets, "<i4") * layout.taxels.newton_per_count)
    return found if attached is None else msgspec.structs.replace(attached, offsets_n=found.offsets_n)


def parse_calibration(content: bytes, layout: Layout, origin: str, *, is_shown: bool = False) -> StoredCalibration:
    """Decode and check the content of a file; `origin` names the file in messages.

    What is only shown or saved may have offsets of sums beyond `most_offset_n`.
    """
    check_bytes(len(content), InputError, origin, BYTES_MAX)
    try:
        version = msgspec.json.decode(content, type=_Version).version
        if version > VERSION:
            raise InputError(
                f"{origin}: a calibration of version {version}, expected {VERSION} at most: update canskin"
            )
        stored = msgspec.json.decode(content, type=StoredCalibration)
    except UNDECODABLE as error:
        raise InputError(f"{origin}: expected a file of 'skin calibration save': {error}") from error
    phi = layout.phi()
    mine = (phi.fingerprint, layout.taxels.force_max_n)
    if (stored.fingerprint, stored.force_max_n) != mine:
        raise InputError(
            f"{origin}: the calibration of another layout, '{stored.skin[:64]}' with Φ {stored.fingerprint[:32]} and"
            f" {stored.force_max_n:g} N: expected '{layout.name}' with Φ {mine[0]} and {mine[1]:g} N"
        )
    for name, found, wanted, most in (
        ("offsets_n", stored.offsets_n, phi.shape[0], np.inf if is_shown else most_offset_n(layout)),
        ("gains", stored.gains, phi.shape[1], MOST_GAIN),
        ("taxel_offsets_n", stored.taxel_offsets_n, phi.shape[1], layout.taxels.force_max_n),
        ("differential_gains", stored.differential_gains, phi.shape[0], MOST_GAIN),
        ("common_mode_gains", stored.common_mode_gains, phi.shape[0], MOST_GAIN),
    ):
        if found and len(found) != wanted:
            raise InputError(f"{origin}: expected {wanted} {name}, or none, got {len(found)}")
        beyond = np.count_nonzero(np.abs(np.array(found, np.float64)) > most)  # None becomes NaN: JSON has none
        if beyond:
            raise InputError(f"{origin}: {beyond} {name} that this skin cannot have: expected -{most:g} to {most:g}")
    if len(stored.differential_gains) != len(stored.common_mode_gains):
        raise InputError(f"{origin}: expected differential_gains and common_mode_gains, or neither")
    return stored
