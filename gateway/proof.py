"""The dialogue that proves a node: its configuration is compared with the contract, and corrected where it differs.

After CiA 302-2, boot NMT slave. One read is enough for a node that computes the signature of its configuration
(2006h). Every object is read when the node computes none, or when the signature differs.

Only a board knows which gains and offsets (2010h, 2011h) are right for its taxels. So each proof compares them with
what an earlier one has found. A node that signs them together with its configuration (2009h) is proven by this one
read while 2009h stays what it was. Of other nodes they are read object by object: all before a node is used, then
`PART` in each proof.
"""

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from dbc import indices as od
from dbc.canopen import COB_ID_INVALID
from dbc.configuration import Setting
from dbc.contract import Contract
from gateway.foreign_sdo import CONFIGURATION, GAINS
from gateway.sdo import Read, SdoAbortedError, Transfer, Write

#: Value of 2006h in a board that computes no signature.
NO_SIGNATURE: Final = 0
#: Gains and offsets that are read in each proof of a node in use that does not sign them.
PART: Final = 2
#: Most objects that a refusal names; of the others it gives the number.
NAMED: Final = 3

_OTHER_CONFIGURATION: Final = f"doubted: its {CONFIGURATION} is not that of the layout"
_OTHER_GAINS: Final = f"doubted: its {GAINS} are not what they were"

Steps = Generator[Transfer, bytes, "Proof"]
_Part = Generator[Transfer, bytes, None]
#: Gains and offsets as a proof has found them: 2009h, or the values by index and sub-index. None: not known.
Gains = int | Mapping[tuple[int, int], bytes] | None


@dataclass
class Proof:
    """Result of a dialogue.

    Attributes
    ----------
    refusal : str
        Why the node's sums must not be used; empty if they may.
    is_other_device : bool
        The node is refused because of its identity (1018h).
    block : int or None
        The block (2000h) of a node that is refused because it has another than the contract's.
    can_write : bool
        The node is refused because of objects that can all be written.
    written : str
        Objects that were written, with their old values.
    has_signature : bool
        The node computes the signature of its configuration.
    gains : Gains
    is_one_read : bool
        The proof was one transfer.
    cost : int
        Transfers of the next proof.
    """

    refusal: str = ""
    is_other_device: bool = False
    block: int | None = None
    can_write: bool = False
    written: str = ""
    has_signature: bool = False
    gains: Gains = None
    is_one_read: bool = False
    cost: int = 1

    def told(self, contract: Contract) -> str:
        """Return the refusal, and of a board that is another of the skin which: its interface may be swapped."""
        homes = [
            f"{contract.layout.bus[each.bus].name} node {each.node_id}"
            for each in contract.nodes
            if each.block == self.block
        ]
        is_home = f"it is the board of {homes[0]}: are interfaces or boards swapped? " if homes else ""
        return f"{is_home}{self.refusal}"


@dataclass
class Known:
    """What is known of a node's gains and offsets before a proof.

    Attributes
    ----------
    settings : sequence of Setting
        These objects (`dbc.configuration.calibration`); none where sums are made before the converters.
    gains : Gains
        As the newest proof has found them.
    accepted : Gains
        As somebody has accepted them; None: those that the next proof finds.
    turn : int
        Place in `settings` of the next object that is read alone.
    is_ours : bool
        The gateway has written since the newest proof.
    """

    settings: Sequence[Setting]
    gains: Gains = None
    accepted: Gains = None
    turn: int = 0
    is_ours: bool = False

    @property
    def is_doubtful(self) -> bool:
        """Whether the node has other gains or offsets than those that somebody has accepted."""
        return self.accepted is not None and self.gains != self.accepted

    def accept(self) -> None:
        """Take note that somebody accepts what the newest proof has found."""
        self.accepted = self.gains

    def write(self) -> None:
        """Take note that the gateway writes gains or offsets: what is found next is right."""
        self.gains = self.accepted = None
        self.is_ours = True

    def doubt(self) -> None:
        """Take note that another master may have written since the gateway has: what is found next is a change."""
        if self.is_ours:
            self.gains = self.accepted = {}
            self.is_ours = False

    def take(self, gains: Gains) -> bool:
        """Take what a proof has found; tell whether that is a change."""
        is_change = self.gains is not None and gains != self.gains
        self.gains, self.is_ours = gains, False
        if self.accepted is None:
            self.accept()
        return is_change


def prove(
    settings: Sequence[Setting],
    signature: int,
    known: Known,
    *,
    write: bool,
    in_use: bool,
    doubt: Callable[[str], None],
) -> Steps:
    """Compare a node with its contract; return the `Proof`.

    Parameters
    ----------
    settings : sequence of Setting
        From `dbc.configuration.configuration`.
    signature : int
        Of these settings, see `dbc.configuration.expected_signature`.
    write : bool
        Write the objects that differ, if all of them can be written; else refuse the node.
    in_use : bool
        The node's sums are used.
    doubt : callable
        Called with the reason when the first difference is found, before any write.

    Raises
    ------
    gateway.sdo.SdoTimeoutError
        If the node does not answer.
    """
    proof = Proof()
    yield from _prove_configuration(settings, signature, known, proof, write=write, doubt=doubt)
    if proof.refusal or proof.is_one_read or not known.settings:
        return proof
    if proof.gains is None:
        proof.gains = yield from _read_gains(known, in_use=in_use and isinstance(known.gains, Mapping), doubt=doubt)
        proof.cost += PART
    elif known.gains not in (None, proof.gains):
        doubt(_OTHER_GAINS)
    return proof


def _prove_configuration(
    settings: Sequence[Setting],
    signature: int,
    known: Known,
    proof: Proof,
    *,
    write: bool,
    doubt: Callable[[str], None],
) -> _Part:
    """Compare all but gains and offsets; note what is found in `proof`."""
    if (yield from _signature_is_right(signature, known, proof)):
        return
    try:
        wrong = yield from _differences(settings)
        if wrong or proof.has_signature:
            doubt(_OTHER_CONFIGURATION)
        if wrong and write and all(setting.is_writable for setting, _ in wrong):
            yield from _write([setting for setting, _ in wrong], settings)
            proof.written = _in_words(wrong)
            if (yield from _signature_is_right(signature, known, proof)):
                return
            wrong = yield from _differences(settings)
    except SdoAbortedError as error:
        doubt(_OTHER_CONFIGURATION)
        proof.refusal = str(error)
        return
    fixed = [(setting, data) for setting, data in wrong if not setting.is_writable]
    if wrong:
        proof.refusal, proof.can_write = _in_words(fixed or wrong), not fixed
        proof.is_other_device = any(setting.index == od.IDENTITY for setting, _ in fixed)
        blocks = [int.from_bytes(data, "little") for setting, data in fixed if setting.index == od.BLOCK]
        proof.block = blocks[0] if blocks else None
    elif proof.has_signature:
        proof.refusal = f"its objects are right, but not their signature ({od.SIGNATURE:04X}h)"
    if not proof.has_signature:
        proof.cost = len(settings) + 1


def _signature_is_right(expected: int, known: Known, proof: Proof) -> Generator[Transfer, bytes, bool]:
    """Read the signatures; tell whether the configuration is that of the contract.

    2009h comes first: a configuration that changes between the two reads is then found now or in the next proof.
    """
    proof.gains, proof.is_one_read = None, False
    if known.settings and not isinstance(known.gains, Mapping):
        whole = yield from _read_signature(od.CALIBRATION_SIGNATURE)
        proof.gains = whole if whole != NO_SIGNATURE else None
        if proof.gains is not None and proof.gains == known.gains:
            proof.has_signature = proof.is_one_read = True
            return True
    found = yield from _read_signature(od.SIGNATURE)
    proof.has_signature = found != NO_SIGNATURE
    proof.is_one_read = not known.settings
    return proof.has_signature and found == expected


def _read_signature(index: int) -> Generator[Transfer, bytes, int]:
    try:
        return int.from_bytes((yield Read(index, 0, od.UNSIGNED32)), "little")
    except SdoAbortedError:
        return NO_SIGNATURE


def _read_gains(known: Known, *, in_use: bool, doubt: Callable[[str], None]) -> Generator[Transfer, bytes, Gains]:
    """Return gains and offsets, read object by object: `PART` of them of a node in use, unless one of these differs."""
    before = known.gains if isinstance(known.gains, Mapping) else {}
    found: dict[tuple[int, int], bytes] = {}
    if in_use:
        part = [known.settings[(known.turn + each) % len(known.settings)] for each in range(PART)]
        known.turn = (known.turn + PART) % len(known.settings)
        found = yield from _values(part)
        if all(before.get(place) == data for place, data in found.items()):
            return before
        doubt(_OTHER_GAINS)
    return (yield from _values(known.settings))


def _values(settings: Sequence[Setting]) -> Generator[Transfer, bytes, dict[tuple[int, int], bytes]]:
    """Return the values of objects by index and sub-index; empty for those that a board does not have."""
    found = {}
    for each in settings:
        try:
            found[each.index, each.subindex] = yield Read(each.index, each.subindex, each.data_type)
        except SdoAbortedError:
            found[each.index, each.subindex] = b""
    return found


def _differences(settings: Sequence[Setting]) -> Generator[Transfer, bytes, list[tuple[Setting, bytes]]]:
    """Return the objects that differ, with their values; a different identity (1018h) ends the comparison."""
    wrong = []
    # The identity first: another device may have none of the other objects.
    for setting in sorted(settings, key=lambda each: each.index != od.IDENTITY):
        data = yield Read(setting.index, setting.subindex, setting.data_type)
        if data != setting.data:
            wrong.append((setting, data))
            if setting.index == od.IDENTITY:
                break
    return wrong


def _write(wrong: Sequence[Setting], settings: Sequence[Setting]) -> _Part:
    """Write the objects that differ, in the order of CiA 301."""
    of_tpdos = {_tpdo(setting.index) for setting in wrong} - {None}
    for setting in wrong:
        if setting.index == od.SYNC_OVERFLOW:
            yield from _write_overflow(setting, settings)
        elif setting.index == od.EMCY_COB_ID:
            # The identifier may change only while the message does not exist (CiA 301, 7.5.2.17).
            yield Write(setting.index, 0, _invalid(setting.data))
            yield Write(setting.index, 0, setting.data)
        elif _tpdo(setting.index) is None:
            yield Write(setting.index, setting.subindex, setting.data)
    for tpdo in sorted(filter(None, of_tpdos)):
        yield from _write_tpdo(tpdo, settings)


def _write_overflow(setting: Setting, settings: Sequence[Setting]) -> _Part:
    """Write 1019h, which may change only while 1006h is 0 (CiA 301, 7.5.2.22)."""
    period = next(each for each in settings if each.index == od.CYCLE_PERIOD_US)
    yield Write(od.CYCLE_PERIOD_US, 0, bytes(4))
    yield Write(setting.index, setting.subindex, setting.data)
    yield Write(od.CYCLE_PERIOD_US, 0, period.data)


def _write_tpdo(tpdo: int, settings: Sequence[Setting]) -> _Part:
    """Write both records of a TPDO (CiA 301, 7.5.2.38): off, no mapping, entries, their number, the rest, on.

    What cannot be written, as the mapping of stepped TPDOs, is right already.
    """
    writable = [each for each in settings if each.is_writable]
    communication = {each.subindex: each for each in writable if each.index == od.TPDO_COMMUNICATION + tpdo - 1}
    mapping = [each for each in writable if each.index == od.TPDO_MAPPING + tpdo - 1]
    cob_id = communication.pop(1)
    yield Write(cob_id.index, 1, _invalid(cob_id.data))
    for count in (each for each in mapping if each.subindex == 0):
        yield Write(count.index, 0, b"\0")
        for entry in mapping:
            if entry.subindex:
                yield Write(entry.index, entry.subindex, entry.data)
        yield Write(count.index, 0, count.data)
    for each in communication.values():
        yield Write(each.index, each.subindex, each.data)
    yield Write(cob_id.index, 1, cob_id.data)


def _tpdo(index: int) -> int | None:
    """Return the number of the TPDO that the record at `index` describes; None for other objects."""
    if od.TPDO_COMMUNICATION <= index < od.TPDO_END:
        return index % 0x200 + 1
    return None


def _invalid(cob_id: bytes) -> bytes:
    return (int.from_bytes(cob_id, "little") | COB_ID_INVALID).to_bytes(4, "little")


def _difference(setting: Setting, data: bytes) -> str:
    return f"{setting} was {setting.text(data)}, not {setting.text()}"


def _in_words(wrong: Sequence[tuple[Setting, bytes]]) -> str:
    named = "; ".join(_difference(setting, data) for setting, data in wrong[:NAMED])
    return named + (f"; and {len(wrong) - NAMED} more" if len(wrong) > NAMED else "")
