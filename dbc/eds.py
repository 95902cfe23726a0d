"""The EDS of each type of node, and the DCF of each node (CiA 306-1).

Nodes whose dictionaries differ in values only are one type. The files use only syntax that every reader knows: decimal
or 0x numbers, ``$NODEID+0x…`` for identifiers, no compact objects, no quotes.

A value that differs between nodes of a type has the default 0 in the EDS, the index of the block FFFFh: no master takes
a board with these values for a node. The DCF has each node's own values as ParameterValue, and so the value of every
object of the proof that can be written: a tool that loads a DCF writes these alone.

Readers disagree on REAL32: CANopenEditor and python-canopen read a decimal fraction, Lely's tools the 32 bits as a
number, and refuse a fraction. So a default is given where it is a whole number, which no reader refuses, and the DCF
has the bits, which python-canopen ignores.

The comments ``;StorageLocation=`` are the storage groups of CANopenEditor (EDSSharp), which reads and writes them so.
"""

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, repeat
from typing import Final

from dbc import indices as od
from dbc.configuration import configuration
from dbc.contract import Contract, NodeContract
from dbc.dictionary import REVISION, dictionary, serial_number
from dbc.objects import Object, Value
from skin.ranges import ranges_text

#: Change it by hand, with `dbc.dictionary.REVISION`, when the dictionary changes.
_DATE: Final = "11-22-2026"
_MANDATORY: Final = (od.DEVICE_TYPE, od.ERROR_REGISTER, od.IDENTITY)
#: Bit rates with a key in the format, kbit/s.
_BITRATES: Final = (10, 20, 50, 125, 250, 500, 800, 1000)
_VARIABLE, _ARRAY, _RECORD = 7, 8, 9
#: CANopenNode's names of the objects that it counts, of which a node has one each.
_COUNT_LABELS: Final = ("NMT", "EM", "SYNC", "SYNC_PROD", "STORAGE", "EM_PROD", "HB_CONS", "HB_PROD", "SDO_SRV")
#: Default of the block's index in an EDS: no block has it.
NO_BLOCK: Final = 0xFFFF
#: What a DCF says of its node: identity, part of Φ, calibration.
_OF_NODE: Final = (
    od.IDENTITY,
    od.BLOCK,
    od.PHI_SEED,
    od.PHI_FINGERPRINT,
    od.ROWS,
    od.TAXELS,
    od.ENCODING,
    od.GAIN,
    od.OFFSET,
    od.SENDING,
)
#: Objects that are set while the node runs; objects that PDOs may carry are, too.
_OF_RUN: Final = (
    od.ERROR_FIELD,
    od.STORE,
    od.RESTORE,
    od.PROGRAM_DATA,
    od.PROGRAM_CONTROL,
    od.PROGRAM_ID,
    od.FLASH_STATUS,
    od.SIGNATURE,
    od.CALIBRATION_SIGNATURE,
    od.COUNTS,
    od.TEST_PATTERN,
    od.REFRESH,
    od.NODE_NOISE,
    od.TEMPERATURE,
)


#: An object, its default in the EDS, and its own value in the DCF; None where the file says nothing.
_Described = tuple[Object, str | None, str | None]


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
    described = zip(dictionaries[0], _defaults(dictionaries, kind), repeat(None))
    return _text(contract, kind, list(described), _file_info(kind.file), {})


def dcfs(contract: Contract, kind: NodeType) -> Iterator[tuple[NodeContract, str]]:
    """Return each node of a type with its DCF, whose file name is ``f"{node_name(contract, node)}.dcf"``."""
    dictionaries = [dictionary(contract, node) for node in kind.nodes]
    defaults = _defaults(dictionaries, kind)
    for node, objects in zip(kind.nodes, dictionaries, strict=True):
        info = _file_info(f"{node_name(contract, node)}.dcf") | {"LastEDS": kind.file}
        proven = {(each.index, each.subindex) for each in configuration(contract, node) if each.is_writable}
        own = [
            _number(each, each.value) if (each.index, each.subindex or 0) in proven else _own_value(each)
            for each in objects
        ]
        described = list(zip(objects, defaults, own, strict=True))
        yield node, _text(contract, kind, described, info, _commissioning(contract, node))


def node_name(contract: Contract, node: NodeContract) -> str:
    """Return the name of a node's files and of the node in its DCF: bus and node-ID."""
    return f"{contract.layout.bus[node.bus].name}-{node.node_id:03}"


def _text(
    contract: Contract, kind: NodeType, described: list[_Described], info: dict[str, str], place: dict[str, str]
) -> str:
    """Return a file: `described` has each object with its default and its own value, `place` is empty in an EDS."""
    objects = [each for each, *_ in described]
    indices = sorted({each.index for each in objects})
    sections = [
        _section("FileInfo", info),
        _section("DeviceInfo", _device_info(contract, kind, indices)),
        *([_section("DeviceComissioning", place)] if place else []),
        _section("DummyUsage", {f"Dummy{number:04}": "0" for number in range(1, 8)}),
        _section("Comments", _comments(contract, kind)),
        _object_list("MandatoryObjects", [index for index in indices if index in _MANDATORY]),
        _object_list(
            "OptionalObjects", [index for index in indices if index < od.MANUFACTURER and index not in _MANDATORY]
        ),
        _object_list("ManufacturerObjects", [index for index in indices if index >= od.MANUFACTURER]),
    ]
    for _, group in groupby(described, key=lambda entry: entry[0].index):
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
    is_pdo = od.TPDO_COMMUNICATION <= each.index < od.TPDO_MAPPING and each.subindex == 1
    is_sdo = each.index == od.SDO_SERVER and each.subindex != 0
    return is_pdo or is_sdo or each.index == od.EMCY_COB_ID


def _offset(value: Value, node: NodeContract) -> int:
    return int(value) - node.node_id


def _defaults(dictionaries: list[list[Object]], kind: NodeType) -> list[str | None]:
    """Return the default of each object of a type."""
    return [
        _default(each, [other[place].value for other in dictionaries], kind.nodes)
        for place, each in enumerate(dictionaries[0])
    ]


def _default(each: Object, values: list[Value], nodes: tuple[NodeContract, ...]) -> str | None:
    """Return the default for all `nodes`; None for a domain, and for a fraction, on whose form readers disagree."""
    if _is_cob_id(each):
        return f"$NODEID+0x{_offset(values[0], nodes[0]):X}"
    if each.data_type == od.DOMAIN:
        return None
    value = values[0]
    if any(other != value for other in values):
        value = NO_BLOCK if each.index == od.BLOCK else 0
    if each.data_type == od.REAL32:
        return str(int(value)) if float(value).is_integer() else None
    return _number(each, value)


def _own_value(each: Object) -> str | None:
    """Return the value of one node for its DCF, None where the default of the EDS holds."""
    if each.data_type == od.REAL32:
        return f"0x{int.from_bytes(struct.pack('<f', each.value), 'little'):08X}"
    is_own = od.split_block(each.index)[1] in _OF_NODE and each.subindex != 0
    return _number(each, each.value) if is_own else None


def _number(each: Object, value: Value) -> str:
    if each.data_type == od.VISIBLE_STRING or each.data_type in od.SIGNED:
        return str(value)
    return f"0x{int(value):X}"


def _section(name: str, entries: dict[str, str]) -> str:
    return "\n".join([f"[{name}]", *(f"{key}={value}" for key, value in entries.items()), ""])


def _object_list(name: str, indices: list[int]) -> str:
    numbered = {str(number): f"0x{index:04X}" for number, index in enumerate(indices, 1)}
    return _section(name, {"SupportedObjects": str(len(indices)), **numbered})


def _object_sections(entries: list[_Described]) -> list[str]:
    """Return the sections of one index: a variable, or a group and its entries, each with default and own value."""
    first = entries[0][0]
    storage = {";StorageLocation": storage_group([each for each, *_ in entries])}
    if first.subindex is None:
        name, kind, *rest = _variable(*entries[0]).items()
        return [_section(f"{first.index:04X}", dict([name, kind]) | storage | dict(rest))]
    group = {
        "ParameterName": first.group,
        "ObjectType": f"0x{_ARRAY if first.array else _RECORD:X}",
        **storage,
        "SubNumber": str(len(entries)),
    }
    return [
        _section(f"{first.index:04X}", group),
        *(_section(f"{entry[0].index:04X}sub{entry[0].subindex:X}", _variable(*entry)) for entry in entries),
    ]


def storage_group(entries: Sequence[Object]) -> str:
    """Return CANopenEditor's storage group of one index; CANopenNode's own program expects 1018h in PERSIST_COMM."""
    index = entries[0].index
    if od.split_block(index)[1] in _OF_RUN or any(each.pdo for each in entries):
        return "RAM"
    if index < od.MANUFACTURER:
        return "PERSIST_COMM"
    return "ROM" if all(each.access != "rw" for each in entries) else "PERSIST_APP"


def _variable(each: Object, default: str | None, own: str | None) -> dict[str, str]:
    return {
        "ParameterName": each.name,
        "ObjectType": f"0x{_VARIABLE:X}",
        "DataType": f"0x{each.data_type:04X}",
        "AccessType": each.access,
        **({} if default is None else {"DefaultValue": default}),
        **({} if own is None else {"ParameterValue": own}),
        "PDOMapping": str(int(each.pdo)),
    }


def _commissioning(contract: Contract, node: NodeContract) -> dict[str, str]:
    """Return the section that gives a node its place; its name in the format is spelt with one m."""
    bus = contract.layout.bus[node.bus]
    return {
        "NodeID": str(node.node_id),
        "NodeName": node_name(contract, node),
        "Baudrate": str(round(bus.bitrate / 1000)),
        "NetNumber": str(node.bus + 1),
        "NetworkName": bus.name,
        "CANopenManager": "0",
        "LSS_SerialNumber": f"0x{serial_number(contract, node):X}",
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
        # Sums of other widths than 8 and 16 bits begin in the middle of a byte.
        "Granularity": str(math.gcd(contract.packing.bits, 8)),
        "DynamicChannelsSupported": "0",
        "GroupMessaging": "0",
        "NrOfRXPDO": "0",
        "NrOfTXPDO": str(sum(od.TPDO_COMMUNICATION <= index < od.TPDO_MAPPING for index in indices)),
        "LSS_Supported": "1",
    }


def _comments(contract: Contract, kind: NodeType) -> dict[str, str]:
    lines = [
        f"Phi {contract.phi.fingerprint}, values that differ between nodes are in their .dcf files",
        f"CANopenNode: {_count_flags(len(kind.nodes[0].tpdos))}",
    ]
    for bus, nodes in groupby(kind.nodes, key=lambda node: node.bus):
        ids = ranges_text(node.node_id for node in nodes)
        lines.append(f"{contract.layout.bus[bus].name}: nodes {ids}")
    return {"Lines": str(len(lines)), **{f"Line{number}": line for number, line in enumerate(lines, 1)}}


def _count_flags(tpdos: int) -> str:
    """Return CANopenNode's numbers of objects as flags of the C compiler.

    CANopenEditor reads its count labels, from which it writes these numbers, from XDD files only.
    """
    counts = dict.fromkeys(_COUNT_LABELS, 1) | {"TPDO": tpdos}
    return " ".join(f"-DOD_CNT_{label}={count}" for label, count in counts.items())
