"""The EDS of each type of node (CiA 306-1). Nodes whose dictionaries differ in values only are one type.

The files use only syntax that every reader knows: decimal or 0x numbers, ``$NODEID+0x…`` for identifiers, no compact
objects. Values that differ between nodes of a type, such as the index of the block, have no default. REAL32 objects
have no default either: some readers expect a decimal fraction, others the 32 bits.
"""

from dataclasses import dataclass
from itertools import groupby
from typing import Final

from dbc.contract import Contract, NodeContract
from dbc.dictionary import REVISION, Object, Value, dictionary
from dbc.indices import (
    OD_DEVICE_TYPE,
    OD_EMCY_COB_ID,
    OD_ERROR_REGISTER,
    OD_IDENTITY,
    OD_MANUFACTURER,
    OD_TPDO_COMMUNICATION,
    OD_TPDO_MAPPING,
    REAL32,
    SIGNED,
    VISIBLE_STRING,
)
from skin.ranges import ranges_text

#: Change it by hand, with `dbc.dictionary.REVISION`, when the dictionary changes.
_DATE: Final = "11-21-2026"
_MANDATORY: Final = (OD_DEVICE_TYPE, OD_ERROR_REGISTER, OD_IDENTITY)
#: Bit rates with a key in the format, kbit/s.
_BITRATES: Final = (10, 20, 50, 125, 250, 500, 800, 1000)
_VARIABLE, _ARRAY, _RECORD = 7, 8, 9


@dataclass(frozen=True)
class NodeType:
    """Nodes with the same EDS, and the name of its file."""

    file: str
    nodes: tuple[NodeContract, ...]


def node_types(contract: Contract) -> list[NodeType]:
    """Return the types of a skin's nodes, ordered by their first node."""
    found: dict[object, list[NodeContract]] = {}
    for node in contract.nodes:
        found.setdefault(_shape(contract, node), []).append(node)
    name = contract.layout.name
    files = [f"{name}.eds"] if len(found) == 1 else [f"{name}-type{number}.eds" for number in range(1, len(found) + 1)]
    return [NodeType(file, tuple(nodes)) for file, nodes in zip(files, found.values(), strict=True)]


def eds(contract: Contract, kind: NodeType) -> str:
    """Return the EDS of a type of node."""
    dictionaries = [dictionary(contract, node) for node in kind.nodes]
    objects = dictionaries[0]
    defaults = [
        _default(each, [other[place].value for other in dictionaries], kind.nodes) for place, each in enumerate(objects)
    ]
    indices = sorted({each.index for each in objects})
    sections = [
        _section("FileInfo", _file_info(kind.file)),
        _section("DeviceInfo", _device_info(contract, kind, indices)),
        _section("DummyUsage", {f"Dummy{number:04}": "0" for number in range(1, 8)}),
        _section("Comments", _comments(contract, kind)),
        _object_list("MandatoryObjects", [index for index in indices if index in _MANDATORY]),
        _object_list(
            "OptionalObjects", [index for index in indices if index < OD_MANUFACTURER and index not in _MANDATORY]
        ),
        _object_list("ManufacturerObjects", [index for index in indices if index >= OD_MANUFACTURER]),
    ]
    for _, group in groupby(zip(objects, defaults, strict=True), key=lambda pair: pair[0].index):
        sections += _object_sections(list(group))
    return "\n".join(sections)


def _shape(contract: Contract, node: NodeContract) -> object:
    """Return a dictionary without its values; identifiers are relative to the node-ID."""
    return tuple(
        (
            each.index,
            each.subindex,
            each.name,
            each.data_type,
            each.access,
            each.pdo,
            each.group,
            each.array,
            _offset(each.value, node) if _is_cob_id(each) else None,
        )
        for each in dictionary(contract, node)
    )


def _is_cob_id(each: Object) -> bool:
    is_pdo = OD_TPDO_COMMUNICATION <= each.index < OD_TPDO_MAPPING and each.subindex == 1
    return is_pdo or each.index == OD_EMCY_COB_ID


def _offset(value: Value, node: NodeContract) -> int:
    return int(value) - node.node_id


def _default(each: Object, values: list[Value], nodes: tuple[NodeContract, ...]) -> str | None:
    """Return the default that is right for all `nodes`, None if there is none."""
    if _is_cob_id(each):
        return f"$NODEID+0x{_offset(values[0], nodes[0]):X}"
    if each.data_type == REAL32 or any(value != values[0] for value in values):
        return None
    if each.data_type == VISIBLE_STRING or each.data_type in SIGNED:
        return str(values[0])
    return f"0x{int(values[0]):X}"


def _section(name: str, entries: dict[str, str]) -> str:
    return "\n".join([f"[{name}]", *(f"{key}={value}" for key, value in entries.items()), ""])


def _object_list(name: str, indices: list[int]) -> str:
    numbered = {str(number): f"0x{index:04X}" for number, index in enumerate(indices, 1)}
    return _section(name, {"SupportedObjects": str(len(indices)), **numbered})


def _object_sections(entries: list[tuple[Object, str | None]]) -> list[str]:
    """Return the sections of one index: a variable, or a group and its entries."""
    first = entries[0][0]
    if first.subindex is None:
        return [_section(f"{first.index:04X}", _variable(*entries[0]))]
    group = {
        "ParameterName": first.group,
        "ObjectType": f"0x{_ARRAY if first.array else _RECORD:X}",
        "SubNumber": str(len(entries)),
    }
    return [
        _section(f"{first.index:04X}", group),
        *(_section(f"{each.index:04X}sub{each.subindex:X}", _variable(each, default)) for each, default in entries),
    ]


def _variable(each: Object, default: str | None) -> dict[str, str]:
    return {
        "ParameterName": each.name,
        "ObjectType": f"0x{_VARIABLE:X}",
        "DataType": f"0x{each.data_type:04X}",
        "AccessType": each.access,
        **({} if default is None else {"DefaultValue": default}),
        "PDOMapping": str(int(each.pdo)),
    }


def _file_info(file: str) -> dict[str, str]:
    return {
        "FileName": file,
        "FileVersion": "1",
        "FileRevision": "0",
        "EDSVersion": "4.0",
        "Description": "Blocks of taxels that send sums on SYNC",
        "CreationTime": "12:00PM",
        "CreationDate": _DATE,
        "CreatedBy": "canskin",
        "ModificationTime": "12:00PM",
        "ModificationDate": _DATE,
        "ModifiedBy": "canskin",
    }


def _device_info(contract: Contract, kind: NodeType, indices: list[int]) -> dict[str, str]:
    rates = {contract.layout.bus[node.bus].bitrate for node in kind.nodes}
    return {
        "VendorName": "canskin",
        "VendorNumber": f"0x{contract.layout.device.vendor_id:X}",
        "ProductName": "canskin SBHE block",
        "ProductNumber": f"0x{contract.layout.device.product_code:X}",
        "RevisionNumber": f"0x{REVISION:X}",
        "OrderCode": "0",
        **{f"BaudRate_{rate}": str(int(1000 * rate in rates)) for rate in _BITRATES},
        "SimpleBootUpMaster": "0",
        "SimpleBootUpSlave": "1",
        # Sums of 12 bits begin in the middle of a byte.
        "Granularity": "4" if contract.packing.bits % 8 else "8",
        "DynamicChannelsSupported": "0",
        "GroupMessaging": "0",
        "NrOfRXPDO": "0",
        "NrOfTXPDO": str(sum(OD_TPDO_COMMUNICATION <= index < OD_TPDO_MAPPING for index in indices)),
        "LSS_Supported": "0",
    }


def _comments(contract: Contract, kind: NodeType) -> dict[str, str]:
    lines = [f"Phi {contract.phi.fingerprint}, gains (2010h) are 1.0 after a reset to defaults"]
    for bus, nodes in groupby(kind.nodes, key=lambda node: node.bus):
        ids = ranges_text(node.node_id for node in nodes)
        lines.append(f"{contract.layout.bus[bus].name}: nodes {ids}")
    return {"Lines": str(len(lines)), **{f"Line{number}": line for number, line in enumerate(lines, 1)}}
