"""The DBC of one bus: every frame that the gateway and the nodes send, for bus analysers and loggers.

Sums are in ADC counts: the factor is the packing's scale, so every value is an exact integer. The factor to newtons is
no exact decimal fraction; the attribute ``NewtonPerCount`` holds it.

cantools writes the text. The committed files change with its version, so its bounds in ``pyproject.toml`` are narrow.
"""

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING, Final

from dbc.canopen import (
    EMCY_BASE,
    HEARTBEAT_BASE,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    TIME_COB_ID,
    NmtCommand,
    NmtState,
)
from dbc.contract import Contract, NodeContract, Tpdo, places_of_sums
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import FD
from dbc.packing import COUNTER_BYTES, rounding_error_n
from dbc.steps import WORD_BYTES
from skin.sync_counter import SYNC_OVERFLOW

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal
    from cantools.database.can.formats.dbc import DbcAttributeDefinitionType, DbcSpecifics

GATEWAY: Final = "Gateway"
UNIT: Final = "count"

#: Frame formats, in the order of the values of the attribute VFrameFormat.
FRAME_FORMATS: Final = (
    *("StandardCAN", "ExtendedCAN", "reserved", "J1939PG"),
    *["reserved"] * 10,
    *("StandardCAN_FD", "ExtendedCAN_FD"),
)


def database(contract: Contract, bus: int) -> str:
    """Return the DBC of bus number `bus`."""
    from cantools.database.can import Bus, Database, Node

    layout, line = contract.layout, contract.layout.bus[bus]
    nodes = contract.on_bus(bus)
    messages = _network(contract) + [message for node in nodes for message in _node(contract, node)]
    comment = (
        f"Bus {line.name} of skin {layout.name}: blocks {nodes[0].block} to {nodes[-1].block + nodes[-1].blocks - 1}"
        f" of Phi {contract.phi.fingerprint}. {_unit_text(contract)}"
    )
    attributes: dict[str, str | int | float] = {
        "DBName": line.name,
        "BusType": "CAN FD" if line.fd else "CAN",
        "Baudrate": line.bitrate,
        **({"BaudrateCANFD": line.data_bitrate or line.bitrate} if line.fd else {}),
        "NewtonPerCount": layout.taxels.newton_per_count,
        "PhiFingerprint": contract.phi.fingerprint,
    }
    described = Database(
        messages=sorted(messages, key=lambda message: message.frame_id),
        nodes=[Node(GATEWAY), *(Node(_name(node)) for node in nodes)],
        buses=[Bus(line.name, comment=comment, baudrate=line.bitrate)],
        dbc_specifics=_attributes(attributes, switches_rate=line.data_bitrate is not None),
    )
    return str(described.as_dbc_string(sort_signals=None)).replace("\r\n", "\n")


def _unit_text(contract: Contract) -> str:
    """Return a sentence on the values of sums."""
    if contract.in_steps:
        return f"Words move or set sums in units of {contract.unit_n:.6g} N, see the document of steps."
    scale, error_n = contract.packing.scale, rounding_error_n(contract.layout)
    exact = f"rounded to {scale}, which adds at most {error_n:.3g} N to a sum" if scale > 1 else "they are exact"
    return f"Sums are in ADC counts, {contract.layout.taxels.newton_per_count:.6g} N each; {exact}."


def signal_name(contract: Contract, number: int) -> str:
    """Return the name of sum `number` of the skin: its block and its Hadamard row."""
    return f"Block{contract.phi.block_of_sum[number]:03}_Row{contract.phi.row_of_sum[number]:02}"


def _attributes(of_network: Mapping[str, str | float], *, switches_rate: bool) -> "DbcSpecifics":
    """Return the attributes of the network, and the definitions of the attributes of messages."""
    from cantools.database.can.formats.dbc import DbcAttribute, DbcAttributeDefinition, DbcSpecifics

    definitions: OrderedDict[str, DbcAttributeDefinitionType] = OrderedDict()
    for name, value in of_network.items():
        if isinstance(value, str):
            definitions[name] = DbcAttributeDefinition(name, default_value="", type_name="STRING")
        elif isinstance(value, int):
            definitions[name] = DbcAttributeDefinition(
                name, default_value=0, type_name="INT", minimum=0, maximum=2**31 - 1
            )
        else:
            definitions[name] = DbcAttributeDefinition(
                name, default_value=0.0, type_name="FLOAT", minimum=0, maximum=1_000_000
            )
    values = OrderedDict((name, DbcAttribute(value, definitions[name])) for name, value in of_network.items())
    of_messages: tuple[DbcAttributeDefinitionType, ...] = (
        DbcAttributeDefinition(
            "GenMsgCycleTime", default_value=0, kind="BO_", type_name="INT", minimum=0, maximum=2**16 - 1
        ),
        DbcAttributeDefinition(
            "VFrameFormat", default_value=FRAME_FORMATS[0], kind="BO_", type_name="ENUM", choices=list(FRAME_FORMATS)
        ),
        # Of the CAN FD frames; cantools adds this definition to every CAN FD bus, with the default 1.
        DbcAttributeDefinition(
            "CANFD_BRS", default_value=str(int(switches_rate)), kind="BO_", type_name="ENUM", choices=["0", "1"]
        ),
    )
    for message in of_messages:
        if message.name != "CANFD_BRS" or of_network["BusType"] == "CAN FD":
            definitions[message.name] = message
    return DbcSpecifics(attributes=values, attribute_definitions=definitions)


def _name(node: NodeContract) -> str:
    return f"Node{node.node_id}"


def _signal(
    name: str,
    start: int,
    bits: int,
    *,
    receiver: str | None,
    is_signed: bool = False,
    factor: int = 1,
    offset: int = 0,
    unit: str | None = None,
    meanings: Mapping[int, str] | None = None,
) -> "Signal":
    """Return an integer of `bits` from bit `start` on: ``physical = raw * factor + offset``."""
    from cantools.database.can import Signal
    from cantools.database.conversion import BaseConversion

    low = -(1 << bits - 1) if is_signed else 0
    return Signal(
        name,
        start,
        bits,
        is_signed=is_signed,
        conversion=BaseConversion.factory(
            scale=factor, offset=offset, choices=OrderedDict(meanings) if meanings else None, is_float=False
        ),
        minimum=low * factor + offset,
        maximum=(low + (1 << bits) - 1) * factor + offset,
        unit=unit,
        receivers=[] if receiver is None else [receiver],
    )


def _message(
    name: str,
    can_id: int,
    length: int,
    sender: str,
    signals: Sequence["Signal"],
    *,
    comment: str | None = None,
    cycle_ms: int | None = None,
    is_fd: bool = False,
) -> "Message":
    from cantools.database.can import Message

    return Message(
        can_id, name, length, list(signals), senders=[sender], comment=comment, cycle_time=cycle_ms, is_fd=is_fd
    )


def _network(contract: Contract) -> list["Message"]:
    """Return the messages that the gateway sends to all nodes."""
    command = _signal("Command", 0, 8, receiver=None, meanings=_in_words(NmtCommand))
    node_id = _signal("NodeId", 8, 8, receiver=None)
    time_s = contract.layout.sync.time_s
    parts = [
        _signal("AfterMidnight", 0, 28, receiver=None, unit="ms"),
        _signal("Days", 32, 16, receiver=None, unit="d"),
    ]
    about = "TIME_OF_DAY in UTC; days since 1984-01-01"
    return [
        _message("NMT", NMT_COB_ID, 2, GATEWAY, [command, node_id], comment="NMT command; node-ID 0 is all nodes"),
        _message(
            "SYNC",
            SYNC_COB_ID,
            COUNTER_BYTES,
            GATEWAY,
            [_signal("Counter", 0, 8 * COUNTER_BYTES, receiver=None)],
            comment=f"All blocks measure now; the counter goes from 1 to {SYNC_OVERFLOW}",
            cycle_ms=_milliseconds(contract.layout.sync.period_s),
        ),
        *(
            _message("TIME", TIME_COB_ID, 6, GATEWAY, parts, comment=about, cycle_ms=_milliseconds(each_s))
            for each_s in ([] if time_s is None else [time_s])
        ),
    ]


def _node(contract: Contract, node: NodeContract) -> list["Message"]:
    """Return the messages from and to one node."""
    name, node_id = _name(node), node.node_id
    emergency = [
        _signal("ErrorCode", 0, 16, receiver=GATEWAY),
        _signal("ErrorRegister", 16, 8, receiver=GATEWAY),
        _signal("ManufacturerField", 24, 40, receiver=GATEWAY),
    ]
    state = [
        _signal(
            "State", 0, 8, receiver=GATEWAY, meanings=_in_words(NmtState) | {NmtState.INITIALISING.value: "Boot-up"}
        )
    ]
    beats = _message(f"{name}_Heartbeat", HEARTBEAT_BASE + node_id, 1, name, state, cycle_ms=HEARTBEAT_MS)
    return [
        *((_words if node.in_steps else _sums)(contract, node, tpdo) for tpdo in node.tpdos),
        _message(f"{name}_EMCY", EMCY_BASE + node_id, 8, name, emergency),
        beats,
        _message(f"{name}_SDO_Request", SDO_REQUEST_BASE + node_id, 8, GATEWAY, _transfer(name)),
        _message(f"{name}_SDO_Response", SDO_RESPONSE_BASE + node_id, 8, name, _transfer(GATEWAY)),
    ]


def _transfer(receiver: str) -> list["Signal"]:
    """Return the signals of an SDO frame."""
    parts = (("Command", 0, 8), ("Index", 8, 16), ("Subindex", 24, 8), ("Data", 32, 32))
    return [_signal(name, start, bits, receiver=receiver) for name, start, bits in parts]


def _sums(contract: Contract, node: NodeContract, tpdo: Tpdo) -> "Message":
    """Return a TPDO with its counter and sums."""
    pack, name, sums = contract.packing, _name(node), range(tpdo.first_sum, tpdo.first_sum + tpdo.sums)
    when = ", after every SYNC"
    if contract.turns > 1:
        counters = ", ".join(str(tpdo.turn + 1 + each * contract.turns) for each in range(3))
        when = f", after SYNC counters {counters}, ..."
    counter = _signal("Counter", 0, 8 * COUNTER_BYTES, receiver=GATEWAY)
    signals = [
        _signal(
            signal_name(contract, number),
            8 * COUNTER_BYTES + place * pack.bits,
            pack.bits,
            receiver=GATEWAY,
            is_signed=pack.is_signed,
            factor=pack.scale,
            offset=-pack.offset * pack.scale,
            unit=UNIT,
        )
        for place, number in enumerate(sums)
    ]
    return _message(
        f"{name}_TPDO{tpdo.number}",
        tpdo.cob_id,
        tpdo.length,
        name,
        [counter, *signals],
        comment=f"Sums {sums[0]} to {sums[-1]}{when}",
        cycle_ms=_milliseconds(contract.turns * contract.layout.sync.period_s),
        is_fd=bool(node.flags & FD),
    )


def _words(contract: Contract, node: NodeContract, tpdo: Tpdo) -> "Message":
    """Return a TPDO of a stepped node with its slot and words."""
    name, parts = _name(node), node.frame_parts
    first, width = parts * (tpdo.number - 1), 8 * WORD_BYTES
    signals = [_signal("Slot", 0, 8 * COUNTER_BYTES, receiver=GATEWAY)]
    for place in range(parts):
        start = 8 * COUNTER_BYTES + place * width
        signals.append(_signal(f"Word{first + place + 1}", start, width, receiver=GATEWAY))
    rows = ", ".join(str(contract.phi.row_of_sum[each]) for each in places_of_sums(contract, node, tpdo))
    return _message(
        f"{name}_TPDO{tpdo.number}",
        tpdo.cob_id,
        tpdo.length,
        name,
        signals,
        comment=f"Words of the sums of block {node.block} of Hadamard rows {rows}",
        is_fd=bool(node.flags & FD),
    )


def _milliseconds(period_s: float) -> int:
    return round(1000 * period_s)


def _in_words(codes: type[IntEnum]) -> dict[int, str]:
    """Return the names of an enumeration for a value table, such as ``Enter pre-operational``."""
    return {code.value: code.name.replace("PRE_", "PRE-").replace("_", " ").capitalize() for code in codes}
