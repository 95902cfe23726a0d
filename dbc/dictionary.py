"""The object dictionary of a skin node as data: the one source of the nodes' objects and of their description.

Manufacturer area, 2000h on: what the node measures. Everything a master needs to refuse a node that was
programmed for another Φ can be read by SDO.
"""

from dataclasses import dataclass
from typing import Final, Literal

from dbc.contract import PHASES, SYNC_COB_ID, SYNC_OVERFLOW, Contract, NodeContract, Tpdo

Access = Literal["ro", "rw", "const"]
Value = int | float | str

#: Data types (CiA 301, table 44).
INTEGER8: Final = 0x02
INTEGER16: Final = 0x03
UNSIGNED8: Final = 0x05
UNSIGNED16: Final = 0x06
UNSIGNED32: Final = 0x07
VISIBLE_STRING: Final = 0x09

OD_DEVICE_TYPE: Final = 0x1000
OD_ERROR_REGISTER: Final = 0x1001
OD_SYNC_COB_ID: Final = 0x1005
OD_CYCLE_PERIOD_US: Final = 0x1006
OD_WINDOW_US: Final = 0x1007
OD_DEVICE_NAME: Final = 0x1008
OD_HARDWARE_VERSION: Final = 0x1009
OD_SOFTWARE_VERSION: Final = 0x100A
OD_HEARTBEAT_MS: Final = 0x1017
OD_IDENTITY: Final = 0x1018
OD_SYNC_OVERFLOW: Final = 0x1019
OD_TPDO_COMMUNICATION: Final = 0x1800
OD_TPDO_MAPPING: Final = 0x1A00
OD_BLOCK: Final = 0x2000
OD_PHI_SEED: Final = 0x2001
OD_PHI_FINGERPRINT: Final = 0x2002
OD_ROWS: Final = 0x2003
OD_SUMS: Final = 0x2100

#: No vendor number has been assigned by CiA to this project; 0 says so.
VENDOR_ID: Final = 0
PRODUCT_CODE: Final = 0x534B_494E
REVISION: Final = 0x0001_0000
HEARTBEAT_MS: Final = 1000
#: Entries of a mapping record: eight objects of one byte fill a classic frame.
MAPPABLE: Final = 8


@dataclass(frozen=True)
class Object:
    """One object: a variable, or with `subindex` one entry of a record or array."""

    index: int
    subindex: int | None
    name: str
    data_type: int
    access: Access
    value: Value
    pdo: bool = False


def dictionary(made: Contract, node: NodeContract) -> list[Object]:
    """Return all objects of `node` with the values it starts with."""
    return [
        *_communication(made, node),
        *(entry for tpdo in node.tpdos for entry in _tpdo(tpdo)),
        *_skin(made, node),
    ]


def _communication(made: Contract, node: NodeContract) -> list[Object]:
    period_us = round(made.layout.sync.period_s * 1e6)
    return [
        Object(OD_DEVICE_TYPE, None, "Device type", UNSIGNED32, "ro", 0),
        Object(OD_ERROR_REGISTER, None, "Error register", UNSIGNED8, "ro", 0),
        Object(OD_SYNC_COB_ID, None, "COB-ID SYNC message", UNSIGNED32, "rw", SYNC_COB_ID),
        Object(OD_CYCLE_PERIOD_US, None, "Communication cycle period", UNSIGNED32, "rw", period_us),
        Object(OD_WINDOW_US, None, "Synchronous window length", UNSIGNED32, "rw", period_us),
        Object(OD_DEVICE_NAME, None, "Manufacturer device name", VISIBLE_STRING, "const", "canskin SBHE block"),
        Object(OD_HARDWARE_VERSION, None, "Manufacturer hardware version", VISIBLE_STRING, "const", "virtual"),
        Object(OD_SOFTWARE_VERSION, None, "Manufacturer software version", VISIBLE_STRING, "const", "1.0"),
        Object(OD_HEARTBEAT_MS, None, "Producer heartbeat time", UNSIGNED16, "rw", HEARTBEAT_MS),
        Object(OD_IDENTITY, 0, "Highest sub-index supported", UNSIGNED8, "const", 4),
        Object(OD_IDENTITY, 1, "Vendor-ID", UNSIGNED32, "ro", VENDOR_ID),
        Object(OD_IDENTITY, 2, "Product code", UNSIGNED32, "ro", PRODUCT_CODE),
        Object(OD_IDENTITY, 3, "Revision number", UNSIGNED32, "ro", REVISION),
        Object(OD_IDENTITY, 4, "Serial number", UNSIGNED32, "ro", node.block + 1),
        Object(OD_SYNC_OVERFLOW, None, "Synchronous counter overflow value", UNSIGNED8, "rw", SYNC_OVERFLOW),
    ]


def _tpdo(tpdo: Tpdo) -> list[Object]:
    """Return the communication record (1800h on) and mapping record (1A00h on) of one TPDO."""
    communication = OD_TPDO_COMMUNICATION + tpdo.number - 1
    mapping = OD_TPDO_MAPPING + tpdo.number - 1
    mapped = [(OD_SUMS << 16) | ((tpdo.first_subindex + place) << 8) | 16 for place in range(tpdo.sums)]
    mapped += [0] * (MAPPABLE - tpdo.sums)
    return [
        Object(communication, 0, "Highest sub-index supported", UNSIGNED8, "const", 6),
        Object(communication, 1, "COB-ID used by TPDO", UNSIGNED32, "rw", 0x4000_0000 | tpdo.cob_id),
        Object(communication, 2, "Transmission type", UNSIGNED8, "rw", PHASES),
        Object(communication, 3, "Inhibit time", UNSIGNED16, "rw", 0),
        Object(communication, 5, "Event timer", UNSIGNED16, "rw", 0),
        Object(communication, 6, "SYNC start value", UNSIGNED8, "rw", tpdo.phase + 1),
        Object(mapping, 0, "Number of mapped objects", UNSIGNED8, "rw", tpdo.sums),
        *(
            Object(mapping, offset + 1, f"Mapped object {offset + 1}", UNSIGNED32, "rw", entry)
            for offset, entry in enumerate(mapped)
        ),
    ]


def _skin(made: Contract, node: NodeContract) -> list[Object]:
    rows = made.phi.rows_of(node.block)
    seed = made.layout.measurement.seed
    return [
        Object(OD_BLOCK, None, "Block index", UNSIGNED16, "ro", node.block),
        Object(OD_PHI_SEED, None, "Seed of the measurement operator", UNSIGNED32, "ro", seed),
        Object(
            OD_PHI_FINGERPRINT,
            None,
            "Fingerprint of the measurement operator",
            VISIBLE_STRING,
            "ro",
            made.phi.fingerprint,
        ),
        Object(OD_ROWS, 0, "Number of rows", UNSIGNED8, "const", len(rows)),
        *(
            Object(OD_ROWS, place, f"Hadamard row of sum {place}", UNSIGNED8, "ro", row)
            for place, row in enumerate(rows, 1)
        ),
        Object(OD_SUMS, 0, "Number of sums", UNSIGNED8, "const", len(rows)),
        *(Object(OD_SUMS, place, f"Sum {place}", INTEGER16, "ro", 0, pdo=True) for place in range(1, len(rows) + 1)),
    ]
