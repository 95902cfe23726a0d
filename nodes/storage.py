"""The parameters of one node that 1010h stores (CiA 301, 7.5.2.13): in memory, and in a file if a folder is given."""

from pathlib import Path
from typing import Annotated

import msgspec

from canskin.errors import UNDECODABLE, InputError
from dbc.canopen import NO_NODE_ID
from dbc.contract import Contract, NodeContract
from shell.output import write_file

#: Values by index and sub-index, in the bytes of an SDO transfer.
Parameters = dict[int, dict[int, bytes]]
_Place = Annotated[str, msgspec.Meta(pattern="^[0-9A-F]{4}:[0-9A-F]{2}$")]
_Value = Annotated[str, msgspec.Meta(pattern="^([0-9a-f]{2})*$")]


class _Stored(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Content of the file: fingerprint of Φ, the values in hexadecimal by ``INDEX:SUBINDEX``, node-ID of LSS."""

    phi: str
    parameters: dict[_Place, _Value]
    node_id: Annotated[int, msgspec.Meta(ge=1, le=NO_NODE_ID)] = NO_NODE_ID


class Storage:
    """Non-volatile parameters of one board.

    Parameters
    ----------
    phi : str
        Fingerprint of Φ: a file of another skin, or one that cannot be read, raises InputError.
    path : Path or None
        File that keeps the parameters beyond the process.
    own : int
        Node-ID of the board, where LSS has stored none.

    Attributes
    ----------
    parameters : dict
        The stored values, of the board with the present node-ID; empty after `clear`.
    node_id : int
        What LSS has stored (CiA 305), `NO_NODE_ID` for none.
    """

    def __init__(self, phi: str, path: Path | None = None, own: int = NO_NODE_ID) -> None:
        self._phi = phi
        self._own = own
        self._path = path
        self.node_id = NO_NODE_ID
        self.parameters: Parameters = {} if path is None else self._load(path)

    @classmethod
    def of_node(cls, contract: Contract, node: NodeContract, folder: Path | None) -> "Storage":
        """Return the storage of a node: its file in `folder`, or memory."""
        name = f"{contract.layout.bus[node.bus].name}-{node.node_id}.json"
        return cls(contract.phi.fingerprint, folder / name if folder else None, node.node_id)

    def save(self, parameters: Parameters) -> None:
        """Store `parameters`; they replace all stored values.

        Raises
        ------
        OSError
            If the file cannot be written; the old values stay.
        """
        self._write(parameters, self.node_id)

    def save_node_id(self, node_id: int) -> None:
        """Store the node-ID; the values of another node-ID are deleted. OSError as of `save`."""
        self._write(self.parameters if node_id == self.owner else {}, node_id)

    @property
    def owner(self) -> int:
        """The node-ID whose values are stored."""
        return self._own if self.node_id == NO_NODE_ID else self.node_id

    def clear(self) -> None:
        """Delete the stored values: the next reset restores the defaults. OSError as of `save`."""
        self._write({}, self.node_id)

    def _write(self, parameters: Parameters, node_id: int) -> None:
        if self._path is not None and (parameters or node_id != NO_NODE_ID):
            flat = {
                f"{index:04X}:{subindex:02X}": data.hex()
                for index, entries in parameters.items()
                for subindex, data in entries.items()
            }
            write_file(self._path, msgspec.json.format(msgspec.json.encode(_Stored(self._phi, flat, node_id))))
        elif self._path is not None:
            self._path.unlink(missing_ok=True)
        self.parameters, self.node_id = parameters, node_id

    def _load(self, path: Path) -> Parameters:
        try:
            stored = msgspec.json.decode(path.read_bytes(), type=_Stored)
            found: Parameters = {}
            for place, value in stored.parameters.items():
                index, subindex = (int(part, 16) for part in place.split(":"))
                found.setdefault(index, {})[subindex] = bytes.fromhex(value)
        except FileNotFoundError:
            return {}
        except OSError as error:
            raise InputError(f"{path}: cannot read the stored parameters: {error.strerror or error}") from error
        except (*UNDECODABLE, ValueError) as error:
            raise InputError(f"{path}: expected parameters stored by a node: {error}; remove the file") from error
        if stored.phi != self._phi:
            raise InputError(
                f"{path}: expected parameters of a skin with Φ {self._phi}, got Φ {stored.phi}:"
                " give another --store folder, or remove the file"
            )
        self.node_id = stored.node_id
        return found
