"""Everything that one board has to know: its place on the bus, its frames, and its part of Φ, as one table.

The table is written as JSON for tools and people who make boards. Values that are objects of the node's dictionary are
taken from there, so the table and the `.eds` and `.dcf` files cannot differ.
"""

import json
from collections.abc import Mapping
from typing import Any

import msgspec

from dbc import indices as od
from dbc.canopen import EXTENDED_ID_MASK, HEARTBEAT_BASE, SDO_REQUEST_BASE, SDO_RESPONSE_BASE
from dbc.configuration import configuration, expected_signature
from dbc.contract import Contract, NodeContract
from dbc.dictionary import dictionary
from dbc.frame import FD
from dbc.objects import Value
from dbc.packing import Packing
from skin.walsh import grouped_rows

#: Initial values of a node's objects, by index and sub-index.
_Values = Mapping[tuple[int, int], Value]


class _Table(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A part of the table; keys without a value are left out."""


class BoardBlock(_Table, frozen=True, kw_only=True):
    """One block of a board.

    Attributes
    ----------
    block : int
        Index of the block in the skin.
    first_sum : int
        Place of its first sum among the sums of the board.
    taxels : list of int
        Row-major index in the skin of the taxel at each place of the chain.
    rows : list of int
        Row of the Sylvester-ordered Hadamard matrix of each sum, in the order of sending.
    signs : list of str
        One ``+`` or ``-`` for each place of the chain, a text for each sum: the board's rows of Φ.
    gain : list of float
        Of each place (2010h), after a reset to defaults.
    offset_counts : list of int
        Of each place (2011h), after a reset to defaults.
    """

    block: int
    first_sum: int
    taxels: list[int]
    rows: list[int]
    signs: list[str]
    gain: list[float]
    offset_counts: list[int]


class MappedObject(_Table, frozen=True, kw_only=True):
    """One mapped object of a TPDO: `bits` of object `index`, `subindex`."""

    index: int
    subindex: int
    bits: int


class BoardTpdo(_Table, frozen=True, kw_only=True):
    """One transmit PDO (18xxh, 1Axxh); `length` is its payload in bytes, padding included."""

    number: int
    cob_id: int
    transmission_type: int
    sync_start_value: int
    inhibit_100us: int
    event_timer_ms: int
    length: int
    mapping: list[MappedObject]


class BoardPart(_Table, frozen=True, kw_only=True):
    """One part of a stepped board: the sums of one word (`dbc.steps.Form`).

    Attributes
    ----------
    sums : int
    radix : int
        Values of a digit of a step.
    has_first : bool
        Whether the first of these sums is that of all taxels, which is never negative.
    """

    sums: int
    radix: int
    has_first: bool


class BoardPacking(_Table, frozen=True, kw_only=True):
    """How a sum of counts becomes the raw value in a PDO.

    Attributes
    ----------
    bits : int
        Width in a PDO.
    step_counts : int
        Counts per step, a power of two.
    zero : int
        Raw value of a sum of 0: 0 for two's complement, else offset binary.
    raw_min, raw_max : int
        Range of the raw values.
    """

    bits: int
    step_counts: int
    zero: int
    raw_min: int
    raw_max: int


class Board(_Table, frozen=True, kw_only=True):
    """The constants of one board; names end in their unit, COB-IDs are 11-bit identifiers.

    Attributes
    ----------
    skin, bus : str
    node_id : int
    bitrate, data_bitrate : int
        Bit/s; `data_bitrate` is missing without bit rate switch.
    is_fd : bool
        PDOs are CAN FD frames; all other frames are classic.
    vendor_id, product_code, revision, serial : int
        Identity (1018h).
    sync_cob_id, sync_period_us, sync_window_us, sync_overflow : int
        1005h, 1006h, 1007h and 1019h, the largest SYNC counter.
    emcy_cob_id, sdo_request_cob_id, sdo_response_cob_id, heartbeat_cob_id, heartbeat_ms : int
    sending : str
        ``synchronous`` or ``steps``.
    frontend : str
        ``analogue`` where one converter reads each sum; missing where each taxel has a converter.
    adc_bits, count_max : int
        Resolution of a converter; largest count of a taxel.
    newton_per_count : float
    samples_per_sync : int
        Samples of each taxel in one cycle; more than one are averaged.
    encoding : int
        2005h.
    packing : BoardPacking
        Of synchronous boards.
    phi_seed : int
        2001h.
    phi_fingerprint : str
        2002h.
    signature : int
        2006h while all objects hold the values of the contract.
    tpdos : list of BoardTpdo
    blocks : list of BoardBlock
    unit_n : float
        2007h of stepped boards.
    quiet, slots_per_sync, slot_offset_us
        2031h of stepped boards.
    parts : list of BoardPart
        Of stepped boards, in the order of the words.
    rows_of_parts : list of int
        Of stepped boards: the Hadamard row of each sum, in the order of the parts.
    """

    skin: str
    bus: str
    node_id: int
    bitrate: int
    data_bitrate: int | None = None
    is_fd: bool
    vendor_id: int
    product_code: int
    revision: int
    serial: int
    sync_cob_id: int
    sync_period_us: int
    sync_window_us: int
    sync_overflow: int
    emcy_cob_id: int
    sdo_request_cob_id: int
    sdo_response_cob_id: int
    heartbeat_cob_id: int
    heartbeat_ms: int
    sending: str
    frontend: str | None = None
    adc_bits: int
    count_max: int
    newton_per_count: float
    samples_per_sync: int
    encoding: int
    packing: BoardPacking | None = None
    phi_seed: int
    phi_fingerprint: str
    signature: int
    tpdos: list[BoardTpdo]
    blocks: list[BoardBlock]
    unit_n: float | None = None
    quiet: float | None = None
    slots_per_sync: int | None = None
    slot_offset_us: int | None = None
    parts: list[BoardPart] | None = None
    rows_of_parts: list[int] | None = None


def board(contract: Contract, node: NodeContract) -> Board:
    """Return the constants of the board of `node`."""
    values: _Values = {(each.index, each.subindex or 0): each.value for each in dictionary(contract, node)}
    layout = contract.layout
    bus = layout.bus[node.bus]
    in_steps = node.in_steps
    return Board(
        skin=layout.name,
        bus=bus.name,
        node_id=node.node_id,
        bitrate=bus.bitrate,
        data_bitrate=bus.data_bitrate,
        is_fd=bool(node.flags & FD),
        vendor_id=int(values[od.IDENTITY, 1]),
        product_code=int(values[od.IDENTITY, 2]),
        revision=int(values[od.IDENTITY, 3]),
        serial=int(values[od.IDENTITY, 4]),
        sync_cob_id=int(values[od.SYNC_COB_ID, 0]),
        sync_period_us=int(values[od.CYCLE_PERIOD_US, 0]),
        sync_window_us=int(values[od.WINDOW_US, 0]),
        sync_overflow=int(values[od.SYNC_OVERFLOW, 0]),
        emcy_cob_id=int(values[od.EMCY_COB_ID, 0]),
        sdo_request_cob_id=SDO_REQUEST_BASE + node.node_id,
        sdo_response_cob_id=SDO_RESPONSE_BASE + node.node_id,
        heartbeat_cob_id=HEARTBEAT_BASE + node.node_id,
        heartbeat_ms=int(values[od.HEARTBEAT_MS, 0]),
        sending=layout.sending,
        frontend="analogue" if layout.taxels.is_analogue else None,
        adc_bits=layout.taxels.adc_bits,
        count_max=layout.taxels.count_max,
        newton_per_count=layout.taxels.newton_per_count,
        samples_per_sync=layout.samples_per_sync,
        encoding=int(values[od.ENCODING, 0]),
        packing=None if in_steps else _packing(node.packing),
        phi_seed=int(values[od.PHI_SEED, 0]),
        phi_fingerprint=contract.phi.fingerprint,
        signature=expected_signature(configuration(contract, node)),
        tpdos=_tpdos(node, values),
        blocks=_blocks(contract, node, values),
        **(_steps(contract, node, values) if in_steps else {}),
    )


def _steps(contract: Contract, node: NodeContract, values: _Values) -> dict[str, Any]:
    """Return what stepped boards have besides."""
    return {
        "unit_n": contract.unit_n,
        "quiet": values[od.SENDING, 1],
        "slots_per_sync": values[od.SENDING, 2],
        "slot_offset_us": values[od.SENDING, 3],
        "parts": [BoardPart(sums=form.sums, radix=form.radix, has_first=bool(form.has_first)) for form in node.forms],
        "rows_of_parts": grouped_rows(contract.phi.block_size).ravel().tolist(),
    }


def _packing(packing: Packing) -> BoardPacking:
    low, high = packing.raw_range
    return BoardPacking(bits=packing.bits, step_counts=packing.scale, zero=packing.offset, raw_min=low, raw_max=high)


def _tpdos(node: NodeContract, values: _Values) -> list[BoardTpdo]:
    tpdos = []
    for each in node.tpdos:
        communication, mapping = od.TPDO_COMMUNICATION + each.number - 1, od.TPDO_MAPPING + each.number - 1
        entries = [int(values[mapping, place]) for place in range(1, int(values[mapping, 0]) + 1)]
        tpdos.append(
            BoardTpdo(
                number=each.number,
                cob_id=int(values[communication, 1]) & EXTENDED_ID_MASK,
                transmission_type=int(values[communication, 2]),
                sync_start_value=int(values[communication, 6]),
                inhibit_100us=int(values[communication, 3]),
                event_timer_ms=int(values[communication, 5]),
                length=each.length,
                mapping=[
                    MappedObject(index=entry >> 16, subindex=entry >> 8 & 0xFF, bits=entry & 0xFF) for entry in entries
                ],
            )
        )
    return tpdos


def _blocks(contract: Contract, node: NodeContract, values: _Values) -> list[BoardBlock]:
    starts = contract.phi.starts
    blocks = []
    for place in range(node.blocks):
        taxels, rows, gain, offset = (
            _array(values, od.of_block(index, place)) for index in (od.TAXELS, od.ROWS, od.GAIN, od.OFFSET)
        )
        blocks.append(
            BoardBlock(
                block=node.block + place,
                first_sum=int(starts[node.block + place] - starts[node.block]),
                taxels=[int(each) for each in taxels],
                rows=[int(row) for row in rows],
                signs=[_signs(int(row), len(taxels)) for row in rows],
                gain=[float(each) for each in gain],
                offset_counts=[int(each) for each in offset],
            )
        )
    return blocks


def _array(values: _Values, index: int) -> list[Value]:
    """Return the entries of an array; none of one that the board has not, as the rows of a block without sums."""
    return [values[index, place] for place in range(1, int(values.get((index, 0), 0)) + 1)]


def _signs(row: int, size: int) -> str:
    """Return a row of the Sylvester-ordered Hadamard matrix: ``-`` where row and place share an odd number of bits."""
    return "".join("-" if (row & place).bit_count() % 2 else "+" for place in range(size))


def board_text(table: Board) -> str:
    """Return the table as JSON: a line for each value, and for each element of a list of tables."""
    return json_text(msgspec.to_builtins(table))


def json_text(value: object, indent: str = "") -> str:
    """Return JSON in which a list of plain values, and a table without tables, take one line."""
    deeper = indent + "  "
    if isinstance(value, dict) and (not indent or any(_is_nested(each) for each in value.values())):
        lines = [f"{deeper}{json.dumps(key)}: {json_text(each, deeper)}" for key, each in value.items()]
        return "{\n" + ",\n".join(lines) + f"\n{indent}}}" + ("" if indent else "\n")
    if isinstance(value, list) and any(isinstance(each, dict | list) for each in value):
        lines = [f"{deeper}{json_text(each, deeper)}" for each in value]
        return "[\n" + ",\n".join(lines) + f"\n{indent}]"
    return json.dumps(value)


def _is_nested(value: object) -> bool:
    return isinstance(value, dict | list)
