"""The object dictionary of a skin node as data, from which the nodes' objects and the EDS are made.

The manufacturer area, from 2000h, holds the node's part of Φ and its counters. A master can read by SDO all objects
that it needs to refuse a node programmed for another Φ.
"""

from typing import Final

from dbc import indices as od
from dbc.canopen import (
    COB_ID_NO_RTR,
    EMCY_BASE,
    EVENT_MANUFACTURER,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
)
from dbc.contract import Contract, NodeContract, Tpdo
from dbc.objects import HIGHEST_SUBINDEX, Access, Object, Value, array, mapping, places, record
from dbc.packing import COUNTER_BYTES, Packing
from dbc.program import ProgramControl
from dbc.steps import WORD_BYTES
from skin.layout import Layout
from skin.sync_counter import SYNC_OVERFLOW

REVISION: Final = 0x0002_0001
#: 100Ah of a board whose program was never exchanged.
VERSION: Final = "1.0"
HEARTBEAT_MS: Final = 1000
#: A node is silent after 1.5 heartbeat periods without a heartbeat.
SILENT_AFTER_S: Final = 1.5 * HEARTBEAT_MS / 1000
#: Time from the end of the SYNC frame to a node's answer, on the clock of the bus; typical of a microcontroller.
REACTION_NS: Final = 100_000
#: Part of the cycle in which TPDOs may be sent (1007h); the bus is then free at the next SYNC.
WINDOW_RATIO: Final = 0.99
#: The error "window missed" ends after this number of SYNCs without a miss: else a full bus carried its reports, too.
WINDOWS_MET: Final = 16
#: Entries of the pre-defined error field.
ERRORS_KEPT: Final = 8
#: Most heartbeats that a node can watch.
HEARTBEATS_WATCHED: Final = 4
#: Value of 2036h, temperature, of a board that does not know its own.
TEMPERATURE_UNKNOWN: Final = 0x7FFF
#: Bit 0 of 1010h and 1011h: the device stores or restores on command (CiA 301, 7.5.2.13).
ON_COMMAND: Final = 1


def window_s(layout: Layout) -> float:
    """Return the synchronous window (1007h): TPDOs that have not gone within it after SYNC are given up."""
    return WINDOW_RATIO * layout.sync.period_s


def dictionary(contract: Contract, node: NodeContract) -> list[Object]:
    """Return all objects of `node` with their initial values, by index and sub-index."""
    return [
        *_communication(contract, node),
        *(entry for tpdo in node.tpdos for entry in _tpdo_communication(contract, tpdo)),
        *(entry for tpdo in node.tpdos for entry in _tpdo_mapping(contract, node, tpdo)),
        *_program_download(),
        *_manufacturer(contract, node),
    ]


def _communication(contract: Contract, node: NodeContract) -> list[Object]:
    period_us = round(contract.layout.sync.period_s * 1e6)
    errors = [f"Standard error field {place}" for place in places(ERRORS_KEPT)]
    watched = [f"Consumer heartbeat time {place}" for place in places(HEARTBEATS_WATCHED)]
    return [
        Object(od.DEVICE_TYPE, None, "Device type", od.UNSIGNED32, "ro", 0),
        Object(od.ERROR_REGISTER, None, "Error register", od.UNSIGNED8, "ro", 0, pdo=True),
        Object(
            od.ERROR_FIELD, 0, "Number of errors", od.UNSIGNED8, "rw", 0, group="Pre-defined error field", array=True
        ),
        *array(od.ERROR_FIELD, "Pre-defined error field", errors, od.UNSIGNED32, "ro")[1:],
        Object(od.SYNC_COB_ID, None, "COB-ID SYNC message", od.UNSIGNED32, "rw", SYNC_COB_ID),
        Object(od.CYCLE_PERIOD_US, None, "Communication cycle period", od.UNSIGNED32, "rw", period_us),
        Object(
            od.WINDOW_US, None, "Synchronous window length", od.UNSIGNED32, "rw", round(window_s(contract.layout) * 1e6)
        ),
        Object(od.DEVICE_NAME, None, "Manufacturer device name", od.VISIBLE_STRING, "const", "canskin SBHE block"),
        Object(od.HARDWARE_VERSION, None, "Manufacturer hardware version", od.VISIBLE_STRING, "const", "virtual"),
        Object(od.SOFTWARE_VERSION, None, "Manufacturer software version", od.VISIBLE_STRING, "const", VERSION),
        *array(od.STORE, "Store parameters", ["Save all parameters"], od.UNSIGNED32, "rw", value=ON_COMMAND),
        *array(
            od.RESTORE, "Restore default parameters", ["Restore all defaults"], od.UNSIGNED32, "rw", value=ON_COMMAND
        ),
        Object(od.EMCY_COB_ID, None, "COB-ID EMCY", od.UNSIGNED32, "rw", EMCY_BASE + node.node_id),
        Object(od.EMCY_INHIBIT_100US, None, "Inhibit time EMCY", od.UNSIGNED16, "rw", 0),
        *array(od.CONSUMER_HEARTBEAT, "Consumer heartbeat time", watched, od.UNSIGNED32, "rw"),
        Object(od.HEARTBEAT_MS, None, "Producer heartbeat time", od.UNSIGNED16, "rw", HEARTBEAT_MS),
        *_identity(contract, node),
        Object(od.SYNC_OVERFLOW, None, "Synchronous counter overflow value", od.UNSIGNED8, "rw", SYNC_OVERFLOW),
        *array(od.ERROR_BEHAVIOUR, "Error behaviour", ["Communication error"], od.UNSIGNED8, "rw"),
        *record(
            od.SDO_SERVER,
            "SDO server parameter",
            [
                ("COB-ID client to server", od.UNSIGNED32, "ro", SDO_REQUEST_BASE + node.node_id),
                ("COB-ID server to client", od.UNSIGNED32, "ro", SDO_RESPONSE_BASE + node.node_id),
            ],
        ),
    ]


def _program_download() -> list[Object]:
    """Return the objects of program download (CiA 302-3) of a board with one program; the board computes the values."""
    names = ["Program 1"]
    return [
        *array(od.PROGRAM_DATA, "Program data", names, od.DOMAIN, "wo"),
        *array(od.PROGRAM_CONTROL, "Program control", names, od.UNSIGNED8, "rw", value=ProgramControl.START),
        *array(od.PROGRAM_ID, "Program software identification", names, od.UNSIGNED32, "ro"),
        *array(od.FLASH_STATUS, "Flash status identification", names, od.UNSIGNED32, "ro"),
    ]


def serial_number(contract: Contract, node: NodeContract) -> int:
    """Return the serial number of a node (1018h:4)."""
    return contract.layout.device.first_serial + node.block


def _identity(contract: Contract, node: NodeContract) -> list[Object]:
    device = contract.layout.device
    entries = (
        (0, HIGHEST_SUBINDEX, od.UNSIGNED8, 4),
        (1, "Vendor-ID", od.UNSIGNED32, device.vendor_id),
        (2, "Product code", od.UNSIGNED32, device.product_code),
        (3, "Revision number", od.UNSIGNED32, REVISION),
        (4, "Serial number", od.UNSIGNED32, serial_number(contract, node)),
    )
    return [Object(od.IDENTITY, sub, name, kind, "ro", value, group="Identity") for sub, name, kind, value in entries]


def _transmission_type(contract: Contract) -> int:
    """Return the number of turns; of stepped nodes 254, or at SYNC 1, or 0 where slots may be empty."""
    if not contract.in_steps:
        return contract.turns
    steps = contract.layout.steps
    return int(steps.quiet == 0) if steps.at_sync else EVENT_MANUFACTURER


def _tpdo_communication(contract: Contract, tpdo: Tpdo) -> list[Object]:
    """Return the communication record (from 1800h); the RTR bit is set: remote frames are not answered.

    With turns a TPDO has the SYNC start value of its turn. A stepped TPDO is fixed: all but its identifier.
    """
    index, group = od.TPDO_COMMUNICATION + tpdo.number - 1, f"TPDO {tpdo.number} communication parameter"
    timing: Access = "const" if contract.in_steps else "rw"
    entries: tuple[tuple[int, str, int, Access, int], ...] = (
        (0, HIGHEST_SUBINDEX, od.UNSIGNED8, "const", 6),
        (1, "COB-ID used by TPDO", od.UNSIGNED32, "rw", COB_ID_NO_RTR | tpdo.cob_id),
        (2, "Transmission type", od.UNSIGNED8, timing, _transmission_type(contract)),
        (3, "Inhibit time", od.UNSIGNED16, timing, 0),
        (5, "Event timer", od.UNSIGNED16, timing, 0),
        (6, "SYNC start value", od.UNSIGNED8, timing, tpdo.turn + 1 if contract.turns > 1 else 0),
    )
    return [Object(index, sub, name, kind, access, value, group=group) for sub, name, kind, access, value in entries]


def _tpdo_mapping(contract: Contract, node: NodeContract, tpdo: Tpdo) -> list[Object]:
    """Return the mapping record (from 1A00h): index, sub-index and bits of the SYNC counter and of each sum.

    That of a stepped TPDO is fixed: the slot and the words of its parts.
    """
    mapped = [od.SYNC_COUNTER << 16 | 8 * COUNTER_BYTES]
    if node.in_steps:
        mapped += [
            od.WORDS << 16 | place << 8 | 8 * WORD_BYTES
            for place in places(node.frame_parts * tpdo.number)[-node.frame_parts :]
        ]
        return mapping(tpdo.number, len(mapped), mapped, "const")
    for each in range(tpdo.first_sum, tpdo.first_sum + tpdo.sums):
        block = int(contract.phi.block_of_sum[each])
        subindex = each - int(contract.phi.starts[block]) + 1
        mapped.append(od.of_block(od.SUMS, block - node.block) << 16 | subindex << 8 | contract.packing.bits)
    return mapping(tpdo.number, len(mapped), mapped + [0] * (node.pdo_bytes - len(mapped)))


def _manufacturer(contract: Contract, node: NodeContract) -> list[Object]:
    """Return the manufacturer objects, by index; objects of each further block are `BLOCK_STRIDE` higher."""
    seed, fingerprint = contract.layout.measurement.seed, contract.phi.fingerprint
    saturated = "Saturated sums" if contract.layout.taxels.is_analogue else "Saturated taxels"
    health = ["SYNC messages seen", "TPDOs sent", "TPDOs dropped outside the window", saturated]
    calibrated = Object(od.CALIBRATION_SIGNATURE, None, "Signature with gains and offsets", od.UNSIGNED32, "ro", 0)
    whole = [
        Object(od.BLOCK, None, "Block index", od.UNSIGNED16, "ro", node.block),
        Object(od.PHI_SEED, None, "Seed of the measurement operator", od.UNSIGNED32, "ro", seed),
        Object(
            od.PHI_FINGERPRINT, None, "Fingerprint of the measurement operator", od.VISIBLE_STRING, "ro", fingerprint
        ),
        Object(od.ENCODING, None, "Encoding of the sums", od.UNSIGNED32, "ro", node.encoding),
        # The node computes the signatures, see `dbc.configuration`.
        Object(od.SIGNATURE, None, "Configuration signature", od.UNSIGNED32, "ro", 0),
        *([] if contract.layout.taxels.is_analogue else [calibrated]),
        *array(od.HEALTH, "Health", health, od.UNSIGNED32, "ro", pdo=True),
    ]
    if node.tpdos:
        counted = "Slot of the words" if node.in_steps else "SYNC counter of the sums"
        whole.append(Object(od.SYNC_COUNTER, None, counted, od.UNSIGNED8, "ro", 0, pdo=True))
    if node.in_steps:
        whole += _stepped_objects(contract, node)
    if contract.layout.taxels.has_thermometers:
        whole.append(Object(od.TEMPERATURE, None, "Temperature in 0.1 K", od.INTEGER16, "ro", TEMPERATURE_UNKNOWN))
    blocks = [each for place in range(node.blocks) for each in _block(contract, node.block + place, place)]
    return sorted(whole + blocks, key=lambda each: each.index)


def slot_offset_us(contract: Contract, node: NodeContract) -> int:
    """Return the offset of a stepped node in its slot (2031h:3), microseconds: the nodes of a bus share the slot."""
    steps, ids = contract.layout.steps, contract.layout.bus[node.bus].ids
    return 0 if steps.at_sync else round(1e6 * steps.slot_s * ids.index(node.node_id) / len(ids))


def _stepped_objects(contract: Contract, node: NodeContract) -> list[Object]:
    """Return what a stepped node has besides: unit, slots, noise, and the words of its frames."""
    size = contract.phi.block_size
    coefficients = [f"Noise of Haar coefficient {place}" for place in places(size)]
    taxels = [f"Noise of the taxel at place {place}" for place in range(size)]
    words = [f"Word of part {place}" for place in places(len(node.forms))]
    sending: list[tuple[str, int, Access, Value]] = [
        ("Quiet", od.REAL32, "rw", contract.layout.steps.quiet),
        ("Slots per SYNC", od.UNSIGNED8, "rw", contract.slots),
        ("Offset in the slot in microseconds", od.UNSIGNED32, "rw", slot_offset_us(contract, node)),
    ]
    return [
        Object(od.UNIT, None, "Unit of the sums in newtons", od.REAL32, "const", contract.unit_n),
        Object(od.REFRESH, None, "1: set all sums", od.UNSIGNED8, "rw", 0),
        *record(od.SENDING, "Sending", sending),
        # 0: learned by the node.
        *array(od.COEFFICIENT_NOISE, "Noise of coefficients in newtons", coefficients, od.REAL32, "rw", value=0.0),
        *array(od.TAXEL_NOISE, "Noise of taxels in newtons", taxels, od.REAL32, "rw", value=0.0),
        Object(od.NODE_NOISE, None, "Noise of the node in newtons", od.REAL32, "ro", 0.0),
        *array(od.WORDS, "Words", words, od.UNSIGNED56, "ro", pdo=True),
    ]


def sum_type(packing: Packing) -> int:
    """Return the data type of a sum."""
    wide, narrow = (od.INTEGER16, od.INTEGER8) if packing.is_signed else (od.UNSIGNED16, od.UNSIGNED8)
    return wide if packing.bits > od.BITS[narrow] else narrow


def _block(contract: Contract, block: int, place: int) -> list[Object]:
    """Return the objects of one block: taxels in chain order, calibration, counts, test pattern, and its sums.

    A board that makes its sums in hardware has neither calibration nor counts of taxels.
    """
    size, rows = contract.phi.block_size, contract.phi.rows_of(block)
    taxels = [int(taxel) for taxel in contract.phi.order[block * size : (block + 1) * size]]
    of = f" of block {place + 1}" if place else ""
    row_names = [f"Row of sum {sum_}" for sum_ in places(len(rows))]
    sums = [f"Sum {sum_}" for sum_ in places(len(rows))]
    taxel_names = [f"Taxel at place {each}" for each in range(size)]
    chain = [f"Place {each}" for each in range(size)]

    def at(index: int) -> int:
        return od.of_block(index, place)

    of_taxels = [
        *array(at(od.GAIN), f"Gain{of}", chain, od.REAL32, "rw", value=1.0),
        *array(at(od.OFFSET), f"Offset in ADC counts{of}", chain, od.INTEGER16, "rw"),
        *array(at(od.COUNTS), f"Counts{of}", chain, od.UNSIGNED16, "ro"),
    ]
    return [
        *(array(at(od.ROWS), f"Hadamard rows{of}", row_names, od.UNSIGNED8, "ro", value=rows) if rows else []),
        *array(at(od.TAXELS), f"Taxels{of}", taxel_names, od.UNSIGNED16, "ro", value=taxels),
        *([] if contract.layout.taxels.is_analogue else of_taxels),
        Object(at(od.TEST_PATTERN), None, f"Test pattern{of}", od.UNSIGNED8, "rw", 0),
        *(array(at(od.SUMS), f"Sums{of}", sums, sum_type(contract.packing), "ro", pdo=True) if rows else []),
    ]
