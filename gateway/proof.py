"""The dialogue that proves a node: its configuration is compared with the contract, and corrected where it differs.

After CiA 302-2, boot NMT slave. One read is enough for a node that computes the signature of its configuration
(2006h). Every object is read when the node computes none, or when the signature differs.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Final

from dbc import indices as od
from dbc.canopen import COB_ID_INVALID
from dbc.configuration import Setting
from gateway.sdo import Read, SdoAbortedError, Transfer, Write

#: Value of 2006h in a board that computes no signature.
NO_SIGNATURE: Final = 0
#: Most objects that a refusal names; of the others it gives the number.
NAMED: Final = 3

Steps = Generator[Transfer, bytes, "Proof"]
_Part = Generator[Transfer, bytes, None]


@dataclass
class Proof:
    """Result of a dialogue.

    Attributes
    ----------
    refusal : str
        Why the node's sums must not be used; empty if they may.
    written : str
        Objects that were written, with their old values.
    has_signature : bool
        The node computes its signature, so the next proof is one transfer.
    """

    refusal: str = ""
    written: str = ""
    has_signature: bool = False


def prove(settings: Sequence[Setting], signature: int, *, write: bool, doubt: Callable[[], None]) -> Steps:
    """Compare a node with its contract; return the `Proof`.

    Parameters
    ----------
    settings : sequence of Setting
        From `dbc.configuration.configuration`.
    signature : int
        Of these settings, see `dbc.configuration.expected_signature`.
    write : bool
        Write the objects that differ, if all of them can be written; else refuse the node.
    doubt : callable
        Called when the first difference is found, before any write.

    Raises
    ------
    gateway.sdo.SdoTimeoutError
        If the node does not answer.
    """
    proof = Proof()
    if (yield from _signature_is_right(signature, proof)):
        return proof
    try:
        wrong = yield from _differences(settings)
        if wrong or proof.has_signature:
            doubt()
        if wrong and write and all(setting.is_writable for setting, _ in wrong):
            yield from _write([setting for setting, _ in wrong], settings)
            proof.written = _in_words(wrong)
            if (yield from _signature_is_right(signature, proof)):
                return proof
            wrong = yield from _differences(settings)
    except SdoAbortedError as error:
        doubt()
        proof.refusal = str(error)
        return proof
    fixed = [(setting, data) for setting, data in wrong if not setting.is_writable]
    if wrong:
        proof.refusal = _in_words(fixed or wrong)
    elif proof.has_signature:
        proof.refusal = f"its objects are right, but not their signature ({od.SIGNATURE:04X}h)"
    return proof


def _signature_is_right(expected: int, proof: Proof) -> Generator[Transfer, bytes, bool]:
    """Read the signature; tell whether it is that of the contract."""
    try:
        found = int.from_bytes((yield Read(od.SIGNATURE)), "little")
    except SdoAbortedError:
        return False
    proof.has_signature = found != NO_SIGNATURE
    return proof.has_signature and found == expected


def _differences(settings: Sequence[Setting]) -> Generator[Transfer, bytes, list[tuple[Setting, bytes]]]:
    """Return the objects that differ, with their values; a different identity (1018h) ends the comparison."""
    wrong = []
    for setting in settings:
        data = yield Read(setting.index, setting.subindex)
        if not setting.matches(data):
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

    What cannot be written, as the mapping of adaptive TPDOs, is right already.
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
    if od.TPDO_COMMUNICATION <= index < od.MANUFACTURER:
        return index % 0x200 + 1
    return None


def _invalid(cob_id: bytes) -> bytes:
    return (int.from_bytes(cob_id, "little") | COB_ID_INVALID).to_bytes(4, "little")


def _difference(setting: Setting, data: bytes) -> str:
    return f"{setting} was {setting.text(data)}, not {setting.text()}"


def _in_words(wrong: Sequence[tuple[Setting, bytes]]) -> str:
    named = "; ".join(_difference(setting, data) for setting, data in wrong[:NAMED])
    return named + (f"; and {len(wrong) - NAMED} more" if len(wrong) > NAMED else "")
