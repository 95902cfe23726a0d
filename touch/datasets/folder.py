"""A data set's folder: a manifest, and one .npy file per signal and chunk, each with its SHA-256.

A file is valid if the manifest names it with the right digest. Files and manifest are written under another name and
then renamed, so an interrupted run leaves no incomplete file that looks complete.
"""

import io
from collections.abc import Sequence
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np

from canskin.errors import UNDECODABLE, InputError, RunError
from shell.output import LOCK, write_file
from skin.difference import difference
from skin.limits import TEXT_BYTES_MAX, read_file
from touch.contact import Force

FORMAT: Final = "canskin data set 1"
MANIFEST: Final = "manifest.json"


class DatasetFolder:
    """The folder of one data set, opened for writing.

    Raise InputError if the folder holds other files or a data set of other settings.

    Parameters
    ----------
    folder : pathlib.Path
        Made if it does not exist. An existing folder must be empty or hold a data set of the same settings.
    about : dict
        Content of the manifest except its chunks; JSON values.
    """

    def __init__(self, folder: Path, about: dict[str, Any]) -> None:
        self.path = folder
        self._manifest = msgspec.json.decode(msgspec.json.encode({"format": FORMAT, **about}))
        self._manifest["chunks"] = self._known_chunks()
        self._save_manifest()

    def holds(self, name: str) -> bool:
        """Tell whether the file `name` exists with the digest of the manifest."""
        entry = self._manifest["chunks"].get(name)
        if entry is None:
            return False
        try:
            with (self.path / name).open("rb") as file:
                digest = file_digest(file, "sha256").hexdigest()
        except OSError:
            return False
        return bool(digest == entry.get("sha256"))

    def put(self, files: dict[str, dict[str, Any]], arrays: Sequence[Force]) -> None:
        """Write files, and enter them and their descriptions in the manifest.

        Raises
        ------
        RunError
            If a file cannot be written.
        """
        for (name, about), values in zip(files.items(), arrays, strict=True):
            data = io.BytesIO()
            np.save(data, values, allow_pickle=False)
            self._write(name, data.getvalue())
            digest = sha256(data.getbuffer()).hexdigest()
            self._manifest["chunks"][name] = {**about, "shape": list(values.shape), "sha256": digest}
        self._save_manifest()

    def _known_chunks(self) -> dict[str, Any]:
        path = self.path / MANIFEST
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                others = [each.name for each in self.path.iterdir() if each.name != LOCK]
                if others:
                    raise InputError(f"'{self.path}' holds {others[0]} and no data set: give an empty or new folder")
                return {}
            found = msgspec.json.decode(read_file(path, InputError, "the manifest", TEXT_BYTES_MAX))
        except OSError as error:
            raise InputError(f"'{self.path}' cannot be used as a folder: {error}; give another --out") from error
        except UNDECODABLE as error:
            raise InputError(f"'{path}' is no manifest: {error}; delete the folder or give another --out") from error
        self._need_same(found)
        return dict(found["chunks"])

    def _need_same(self, found: Any) -> None:
        where = f"'{self.path}' holds"
        mend = "delete it or give another --out"
        if not isinstance(found, dict) or not isinstance(found.get("chunks"), dict):
            raise InputError(f"{where} a manifest that is not of '{FORMAT}': {mend}")
        parts = ("format", "data_set", "made_by", "settings")
        theirs, ours = ({name: each.get(name) for name in parts} for each in (found, self._manifest))
        if differs := difference(theirs, ours):
            raise InputError(f"{where} another data set ({differs}): {mend}")

    def _save_manifest(self) -> None:
        self._write(MANIFEST, msgspec.json.format(msgspec.json.encode(self._manifest), indent=1))

    def _write(self, name: str, content: bytes) -> None:
        place = self.path / name
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            write_file(place, content)
        except OSError as error:
            raise RunError(f"'{place}' cannot be written: {error}; run it again to go on") from error
