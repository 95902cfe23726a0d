"""The model file: one ``.npz`` of float64 arrays and JSON metadata; reading it runs no code from the file.

Its entries are the arrays of `classifier.model.Model` by name, ``metadata`` (uint8, UTF-8 JSON of
`classifier.model.Metadata`), and ``digest`` (uint8, shape (32,)), the SHA-256 of all other entries.
"""

import hashlib
import io
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.errors import UNDECODABLE, ModelError, reasoned
from classifier.dag import pairs
from classifier.features import widths_for
from classifier.model import ARRAYS, VERSION, Metadata, Model
from classifier.newest_sums import averaged_cycles
from shell.output import write_file
from skin.difference import difference
from skin.layout import Layout
from skin.limits import UNPACKED_BYTES_MAX, check_unpacked, read_file
from skin.phi import Phi

Arrays = dict[str, npt.NDArray[Any]]


class _Version(msgspec.Struct):
    version: int


def save_model(model: Model, path: Path) -> None:
    """Write `model` to `path` in one step: a reader sees the old file or the new one.

    Raises
    ------
    ModelError
        If the file cannot be written.
    """
    metadata = msgspec.json.encode(model.metadata)
    arrays = {name: np.ascontiguousarray(getattr(model, name), "<f8") for name in ARRAYS}
    content = io.BytesIO()
    np.savez(
        content,
        allow_pickle=False,
        metadata=np.frombuffer(metadata, np.uint8),
        digest=np.frombuffer(_digest(metadata, arrays), np.uint8),
        **arrays,
    )
    with reasoned(ModelError, f"{path}: cannot write the model"):
        write_file(path, content.getvalue())


def load_model(path: Path, layout: Layout, phi: Phi) -> Model:
    """Read a model for the skin of `layout`, whose classified Φ (`classifier.used_sums`) is `phi`.

    Raises
    ------
    ModelError
        If the file is missing, unreadable, damaged, of another version, or was trained for another skin.
    """
    about, arrays, is_whole = read_model(path)
    _check_skin(path, about, layout, phi)
    _check_arrays(path, about, arrays, len(widths_for(layout.taxels.surface)))
    if not is_whole:
        raise ModelError(f"{path}: damaged model: its digest does not fit its content; train it again")
    return Model(about, layout.taxels.surface, **arrays)


def read_model(path: Path) -> tuple[Metadata, Arrays, bool]:
    """Read a model of any skin, and tell whether its digest fits; raise ModelError as `load_model`."""
    entries = _entries(path)
    metadata = entries["metadata"].tobytes()
    arrays = {name: entries[name] for name in ARRAYS}
    try:
        version = msgspec.json.decode(metadata, type=_Version).version
        if version != VERSION:
            raise ModelError(f"{path}: version {version} of the model format, expected {VERSION}: train it again")
        about = msgspec.json.decode(metadata, type=Metadata)
    except UNDECODABLE as error:
        raise ModelError(f"{path}: damaged model: {error}") from error
    return about, arrays, entries["digest"].tobytes() == _digest(metadata, arrays)


def _entries(path: Path) -> Arrays:
    wanted = (*ARRAYS, "metadata", "digest")
    content = io.BytesIO(read_file(path, ModelError, "the model", UNPACKED_BYTES_MAX))
    try:
        check_unpacked(content, path)
        with np.lib.npyio.NpzFile(content, allow_pickle=False) as file:
            missing = [name for name in wanted if name not in file]
            entries = {name: np.asarray(file[name]) for name in wanted if name in file}
    except Exception as error:  # the zip and npy decoders raise many kinds of errors
        raise ModelError(f"{path}: not a readable model ({error}): expected an .npz made by 'skin train'") from error
    if missing:
        raise ModelError(f"{path}: not a model: it lacks {', '.join(missing)}")
    return entries


def skin_of(layout: Layout, phi: Phi) -> dict[str, Any]:
    """Return the fields of `Metadata` that a model and its skin have in common; `phi` is the classified Φ."""
    taxels = layout.taxels
    return {
        "sending": layout.sending,
        "fingerprint": phi.fingerprint,
        "sums": phi.shape[0],
        "rows": taxels.rows,
        "columns": taxels.columns,
        "surface": taxels.surface.fingerprint,
        "newton_per_count": taxels.newton_per_count,
        "cycles": averaged_cycles(layout),
    }


def _check_skin(path: Path, about: Metadata, layout: Layout, phi: Phi) -> None:
    wants = skin_of(layout, phi)
    if differs := difference({name: getattr(about, name) for name in wants}, wants, "model", "this skin has"):
        raise ModelError(f"{path}: trained for another skin ({differs}); train one with 'skin train --layout'")


def _check_arrays(path: Path, about: Metadata, arrays: Arrays, widths: int) -> None:
    classes = len(about.classes)
    if classes < 2 or len(set(about.classes)) < classes or "" in about.classes:
        raise ModelError(f"{path}: damaged model: expected 2 or more different object names")
    for name, shape in _shapes(about, arrays, widths).items():
        array = arrays[name]
        if array.shape != shape or array.dtype != np.dtype("<f8"):
            raise ModelError(
                f"{path}: damaged model: '{name}' is {array.dtype} {array.shape}, expected float64 {shape}"
            )
        if not np.isfinite(array).all():
            raise ModelError(f"{path}: damaged model: '{name}' holds values that are not finite")
    positive = (*arrays["no_touch"][1::2].flat, *arrays["no_touch"][2], *arrays["limits"])
    if min(positive) <= 0:
        raise ModelError(f"{path}: damaged model: deviations, peaks and limits must be above 0")
    if arrays["sum_loadings"].size and about.sum_noise <= 0:
        raise ModelError(f"{path}: damaged model: sum_noise must be above 0")


def _shapes(about: Metadata, arrays: Arrays, widths: int) -> dict[str, tuple[int, ...]]:
    """Return the shape of every array; the numbers of regions and factors are taken from the arrays."""
    planes = len(pairs(len(about.classes)))
    raw = about.features == "sums"
    features = about.sums if raw else 2 * widths
    sums = about.sums if raw else 0
    regions = arrays["limits"].shape[0] if arrays["limits"].ndim else 0
    factors = arrays["sum_loadings"].shape[-1] if arrays["sum_loadings"].ndim and raw else 0
    return {
        "weights": (planes, features),
        "biases": (planes,),
        "offset": (features,),
        "scale": (features,),
        "no_touch": (4, widths),
        "centres": (regions, 2 * widths),
        "whitening": (regions, 2 * widths, 2 * widths),
        "limits": (regions,),
        "sum_mean": (sums,),
        "sum_loadings": (sums, factors),
    }


def _digest(metadata: bytes, arrays: Arrays) -> bytes:
    digest = hashlib.sha256(metadata)
    for name in ARRAYS:
        digest.update(arrays[name].tobytes())
    return digest.digest()
