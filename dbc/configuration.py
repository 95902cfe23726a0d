"""The objects of a node that the gateway compares before it uses the node's sums, and their signature.

A TPDO does not tell its mapping. A block is valid only while these objects are known to have the values of the
contract: identity, identifiers, mapping, SYNC, test pattern, Φ, and unit (2007h) and slots (2031h:2) of steps.
What a node learns, and what it leaves out, does not alter what a frame means.
"""

import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Final

import msgspec

from dbc import indices as od
from dbc.contract import Contract, NodeContract
from dbc.dictionary import dictionary
from dbc.objects import Object

#: Sub-indices of an object that are compared; objects without an entry are compared whole.
_COMPARED: Final = {od.IDENTITY: (1, 2), od.SENDING: (2,)}
#: COB-ID, transmission type and SYNC start value; the other sub-indices concern event-driven PDOs only.
_COMPARED_OF_TPDO: Final = (1, 2, 6)
_WHOLE: Final = (
    od.SYNC_COB_ID,
    od.CYCLE_PERIOD_US,
    od.WINDOW_US,
    od.EMCY_COB_ID,
    od.HEARTBEAT_MS,
    od.SYNC_OVERFLOW,
    od.BLOCK,
    od.PHI_FINGERPRINT,
    od.ENCODING,
    od.UNIT,
)

#: Shortest time of a round, see `proof_period_s`.
PROOF_PERIOD_S: Final = 2.0
#: Highest bus load of reading signatures.
PROOF_LOAD_RATIO: Final = 0.005
#: Request and answer of one expedited transfer: two frames of 8 bytes, 111 bits without stuff bits, 24 bits of these.
PROOF_BITS: Final = 2 * (111 + 24)
#: Most proofs, and other SDO dialogues, at the same time on a bus: SDO frames have a lower priority than TPDOs.
DIALOGUES: Final = 16
#: How often the gateway looks at every node, and how often it reads frames at least while it proves nodes.
TICK_S: Final = 0.01
READ_S: Final = 0.001
#: Shortest time between PRE-OPERATIONAL and NMT start of all nodes: a slave may keep the newest command only.
QUIET_S: Final = 0.01
#: A block is not valid after this number of rounds without answer of its node.
PROOF_ROUNDS: Final = 2


class Setting(msgspec.Struct, frozen=True):
    """One object that the gateway compares: `data` is its value in the bytes of an SDO transfer."""

    index: int
    subindex: int
    name: str
    data: bytes
    data_type: int
    is_writable: bool

    def text(self, data: bytes | None = None) -> str:
        """Return `data`, by default the value itself, as text for the user."""
        value = self.data if data is None else data
        is_text = self.data_type == od.VISIBLE_STRING
        return value.decode("ascii", "replace") if is_text else f"{int.from_bytes(value, 'little'):X}h"

    def __str__(self) -> str:
        return f"{self.index:04X}h:{self.subindex} ({self.name})"


def configuration(contract: Contract, node: NodeContract) -> tuple[Setting, ...]:
    """Return the objects that a master compares and that the signature covers, in ascending order."""
    return compared(contract, node)[0]


def calibration(contract: Contract, node: NodeContract) -> tuple[Setting, ...]:
    """Return gains and offsets (2010h, 2011h), in ascending order: a master compares them with what they were.

    The values are the defaults; which are right for a board, its calibration tells.
    """
    return compared(contract, node)[1]


def compared(contract: Contract, node: NodeContract) -> tuple[tuple[Setting, ...], tuple[Setting, ...]]:
    """Return `configuration` and `calibration`."""
    objects = dictionary(contract, node)
    mapped = {each.index: int(each.value) for each in objects if each.subindex == 0 and _is_mapping(each.index)}
    return (
        tuple(setting_of(each) for each in objects if _is_compared(each, mapped)),
        tuple(setting_of(each) for each in objects if each.subindex and _is_calibration(each)),
    )


def with_calibration(settings: Iterable[Setting], gains: Iterable[Setting]) -> tuple[Setting, ...]:
    """Return the objects that 2009h covers, in ascending order: those of `configuration` and of `calibration`."""
    return tuple(sorted((*settings, *gains), key=lambda each: (each.index, each.subindex)))


def signature(values: Iterable[tuple[int, int, bytes]]) -> int:
    """Return the signature of index, sub-index and value of each object.

    2006h is that of `configuration`, 2009h that of `with_calibration`.

    CRC-32 (polynomial 04C11DB7h reflected, as in IEEE 802.3) over index (2 bytes), sub-index (1 byte) and value, each
    little endian, of all objects one after another.
    """
    crc = 0
    for index, subindex, data in values:
        crc = zlib.crc32(struct.pack("<HB", index, subindex) + data, crc)
    return crc


def expected_signature(settings: Iterable[Setting]) -> int:
    """Return the signature of a node that holds exactly `settings`."""
    return signature((each.index, each.subindex, each.data) for each in settings)


def proof_period_s(contract: Contract, bus: int) -> float:
    """Return the time in which the gateway reads every signature of a bus once.

    `PROOF_PERIOD_S`, or longer if this would take more than `PROOF_LOAD_RATIO` of the bus.
    """
    wires = contract.layout.bus[bus]
    return max(PROOF_PERIOD_S, wires.nodes * PROOF_BITS / (PROOF_LOAD_RATIO * wires.bitrate))


def _is_mapping(index: int) -> bool:
    return od.TPDO_MAPPING <= index < od.TPDO_END


def _is_compared(each: Object, mapped: Mapping[int, int]) -> bool:
    subindex = each.subindex or 0
    if od.TPDO_COMMUNICATION <= each.index < od.TPDO_MAPPING:
        return subindex in _COMPARED_OF_TPDO
    if _is_mapping(each.index):
        return subindex <= mapped[each.index]
    if each.index in _COMPARED:
        return subindex in _COMPARED[each.index]
    return od.split_block(each.index)[1] in (*_WHOLE, od.TEST_PATTERN)


def _is_calibration(each: Object) -> bool:
    return od.split_block(each.index)[1] in (od.GAIN, od.OFFSET)


def setting_of(each: Object) -> Setting:
    """Return an object with its initial value as a setting."""
    if each.data_type == od.VISIBLE_STRING:
        data = str(each.value).encode("ascii")
    elif each.data_type == od.DOMAIN:
        data = b""
    elif each.data_type == od.REAL32:
        data = struct.pack("<f", each.value)
    else:
        data = int(each.value).to_bytes(od.BITS[each.data_type] // 8, "little", signed=each.data_type in od.SIGNED)
    name = f"{each.group}, {each.name}" if each.group else each.name
    return Setting(each.index, each.subindex or 0, name, data, each.data_type, each.access == "rw")
