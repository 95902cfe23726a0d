"""The DBC of one bus: every frame that the gateway and the nodes send, for bus analysers and loggers.

Sums are given in ADC counts: the factor is the packing's scale, so that every value is an exact integer. Their
newtons are a factor away which no decimal fraction gives exactly; it is the attribute ``NewtonPerCount``.
"""

from typing import Final

from dbc.canopen import EMCY_BASE, HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, SYNC_COB_ID
from dbc.contract import PHASES, SYNC_OVERFLOW, Contract, NodeContract, Tpdo
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import FD
from dbc.notation import Message, Signal, dbc_text
from dbc.packing import rounding_error_n

GATEWAY: Final = "Gateway"
#: Receiver of a message that concerns everybody.
EVERYBODY: Final = "Vector__XXX"
UNIT: Final = "count"

NMT_COMMANDS: Final = {
    1: "Start",
    2: "Stop",
    128: "Enter pre-operational",
    129: "Reset node",
    130: "Reset communication",
}
NMT_STATES: Final = {0: "Boot-up", 4: "Stopped", 5: "Operational", 127: "Pre-operational"}


def database(contract: Contract, bus: int) -> str:
    """Return the DBC of bus number `bus`."""
    layout, wires = contract.layout, contract.layout.bus[bus]
    nodes = contract.on_bus(bus)
    messages = _network(contract) + [message for node in nodes for message in _node(contract, node)]
    scale, error_n = contract.packing.scale, rounding_error_n(layout)
    comment = (
        f"Bus {wires.name} of skin {layout.name}: blocks {nodes[0].block} to {nodes[-1].block + nodes[-1].blocks - 1}"
        f" of Phi {contract.phi.fingerprint}. Sums are in ADC counts, {layout.taxels.newton_per_count:.6g} N each;"
        + (f" rounded to {scale}, which adds at most {error_n:.3g} N to a sum." if scale > 1 else " they are exact.")
    )
    attributes: dict[str, str | int | float] = {
        "DBName": wires.name,
        "BusType": "CAN FD" if wires.fd else "CAN",
        "Baudrate": wires.bitrate,
        **({"BaudrateCANFD": wires.data_bitrate or wires.bitrate} if wires.fd else {}),
        "NewtonPerCount": layout.taxels.newton_per_count,
        "PhiFingerprint": contract.phi.fingerprint,
    }
    return dbc_text([GATEWAY, *(_name(node) for node in nodes)], messages, comment, attributes)


def signal_name(contract: Contract, number: int) -> str:
    """Return the name of sum `number` of the skin: its block and its Hadamard row."""
    return f"Block{contract.phi.block_of_sum[number]:03}_Row{contract.phi.row_of_sum[number]:02}"


def _name(node: NodeContract) -> str:
    return f"Node{node.node_id}"


def _network(contract: Contract) -> list[Message]:
    """Return what the gateway sends to all nodes."""
    command = (Signal("Command", 0, 8, meanings=NMT_COMMANDS), Signal("NodeId", 8, 8))
    return [
        Message("NMT", NMT_COB_ID, 2, GATEWAY, EVERYBODY, command, "NMT command; node-ID 0 is all nodes"),
        Message(
            "SYNC",
            SYNC_COB_ID,
            1,
            GATEWAY,
            EVERYBODY,
            (Signal("Counter", 0, 8),),
            f"All blocks measure now; the counter goes from 1 to {SYNC_OVERFLOW}",
            _milliseconds(contract.layout.sync.period_s),
        ),
    ]


def _node(contract: Contract, node: NodeContract) -> list[Message]:
    """Return what one node sends, and what is sent to it alone."""
    name, node_id = _name(node), node.node_id
    emergency = (Signal("ErrorCode", 0, 16), Signal("ErrorRegister", 16, 8), Signal("ManufacturerField", 24, 40))
    state = (Signal("State", 0, 8, meanings=NMT_STATES),)
    transfer = (Signal("Command", 0, 8), Signal("Index", 8, 16), Signal("Subindex", 24, 8), Signal("Data", 32, 32))
    return [
        *(_sums(contract, node, tpdo) for tpdo in node.tpdos),
        Message(f"{name}_EMCY", EMCY_BASE + node_id, 8, name, GATEWAY, emergency),
        Message(f"{name}_Heartbeat", HEARTBEAT_BASE + node_id, 1, name, GATEWAY, state, cycle_ms=HEARTBEAT_MS),
        Message(f"{name}_SDO_Request", SDO_REQUEST_BASE + node_id, 8, GATEWAY, name, transfer),
        Message(f"{name}_SDO_Response", SDO_RESPONSE_BASE + node_id, 8, name, GATEWAY, transfer),
    ]


def _sums(contract: Contract, node: NodeContract, tpdo: Tpdo) -> Message:
    """Return a TPDO with its sums."""
    pack, name, sums = contract.packing, _name(node), range(tpdo.first_sum, tpdo.first_sum + tpdo.sums)
    counters = ", ".join(str(tpdo.phase + 1 + turn * PHASES) for turn in range(3))
    signals = tuple(
        Signal(
            signal_name(contract, number),
            place * pack.bits,
            pack.bits,
            is_signed=pack.is_signed,
            factor=pack.scale,
            offset=-pack.offset * pack.scale,
            unit=UNIT,
        )
        for place, number in enumerate(sums)
    )
    return Message(
        f"{name}_TPDO{tpdo.number}_Phase{tpdo.phase + 1}",
        tpdo.cob_id,
        tpdo.length,
        name,
        GATEWAY,
        signals,
        f"Sums {sums[0]} to {sums[-1]} in phase {tpdo.phase + 1} of {PHASES}: after SYNC counters {counters}, ...",
        _milliseconds(PHASES * contract.layout.sync.period_s),
        is_fd=bool(node.flags & FD),
    )


def _milliseconds(period_s: float) -> int:
    return round(1000 * period_s)
