"""The text of a DBC file, for messages on 11-bit identifiers with Intel signals.

Written here and not by a library, so that the committed files do not change with a library's version; the tests
read them with cantools.
"""

from dataclasses import dataclass, field
from typing import Final

#: VFrameFormat of a CAN FD message with an 11-bit identifier, and of a classic one.
_FRAME_FORMATS: Final = '"StandardCAN","ExtendedCAN","reserved","J1939PG",' + ",".join(
    ['"reserved"'] * 10 + ['"StandardCAN_FD"', '"ExtendedCAN_FD"']
)
_STANDARD_FD: Final = 14


@dataclass(frozen=True)
class Signal:
    """An integer of `bits` from bit `start` on: ``physical = raw * factor + offset``."""

    name: str
    start: int
    bits: int
    is_signed: bool = False
    factor: int = 1
    offset: int = 0
    unit: str = ""
    meanings: dict[int, str] = field(default_factory=dict)

    @property
    def limits(self) -> tuple[int, int]:
        """Physical value of the lowest and the highest raw value."""
        low = -(1 << self.bits - 1) if self.is_signed else 0
        return low * self.factor + self.offset, (low + (1 << self.bits) - 1) * self.factor + self.offset


@dataclass(frozen=True)
class Message:
    """One frame; `cycle_ms` 0 for one that is not sent periodically."""

    name: str
    can_id: int
    length: int
    sender: str
    receiver: str
    signals: tuple[Signal, ...]
    comment: str = ""
    cycle_ms: int = 0
    is_fd: bool = False


def dbc_text(nodes: list[str], messages: list[Message], comment: str, attributes: dict[str, str | int | float]) -> str:
    """Return a DBC file.

    Parameters
    ----------
    nodes : list of str
        Every sender and receiver.
    comment : str
        Of the network.
    attributes : dict
        Of the network, by name.
    """
    ordered = sorted(messages, key=lambda message: message.can_id)
    parts = [
        'VERSION ""',
        "NS_ :",
        "BS_:",
        f"BU_: {' '.join(nodes)}",
        *(_message(message) for message in ordered),
        "\n".join(_comments(comment, ordered)),
        "\n".join([*_definitions(attributes), *_values(attributes, ordered)]),
        "\n".join(_meanings(ordered)),
    ]
    return "\n\n".join(parts) + "\n"


def _message(message: Message) -> str:
    lines = [f"BO_ {message.can_id} {message.name}: {message.length} {message.sender}"]
    for each in message.signals:
        low, high = each.limits
        place = f"{each.start}|{each.bits}@1{'-' if each.is_signed else '+'}"
        meaning = f"({each.factor},{each.offset}) [{low}|{high}]"
        lines.append(f' SG_ {each.name} : {place} {meaning} "{each.unit}" {message.receiver}')
    return "\n".join(lines)


def _comments(network: str, messages: list[Message]) -> list[str]:
    said = [f'CM_ BO_ {each.can_id} "{each.comment}";' for each in messages if each.comment]
    return [f'CM_ "{network}";', *said]


def _definitions(attributes: dict[str, str | int | float]) -> list[str]:
    kinds = {str: ("STRING", '""'), int: ("INT 0 2147483647", "0"), float: ("FLOAT 0 1000000", "0")}
    definitions = {f'"{name}" {kinds[type(value)][0]}': kinds[type(value)][1] for name, value in attributes.items()}
    definitions['BO_ "GenMsgCycleTime" INT 0 65535'] = "0"
    definitions[f'BO_ "VFrameFormat" ENUM {_FRAME_FORMATS}'] = '"StandardCAN"'
    names = [definition.split('"')[1] for definition in definitions]
    return [
        *(f"BA_DEF_ {definition};" for definition in definitions),
        *(f'BA_DEF_DEF_ "{name}" {value};' for name, value in zip(names, definitions.values(), strict=True)),
    ]


def _values(attributes: dict[str, str | int | float], messages: list[Message]) -> list[str]:
    lines = [f'BA_ "{name}" {_quoted(value)};' for name, value in attributes.items()]
    for each in messages:
        if each.cycle_ms:
            lines.append(f'BA_ "GenMsgCycleTime" BO_ {each.can_id} {each.cycle_ms};')
        if each.is_fd:
            lines.append(f'BA_ "VFrameFormat" BO_ {each.can_id} {_STANDARD_FD};')
    return lines


def _quoted(value: str | float) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _meanings(messages: list[Message]) -> list[str]:
    return [
        f"VAL_ {message.can_id} {signal.name} "
        + "".join(f'{raw} "{name}" ' for raw, name in signal.meanings.items())
        + ";"
        for message in messages
        for signal in message.signals
        if signal.meanings
    ]
