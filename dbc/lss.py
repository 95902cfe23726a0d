"""Frames of LSS (CiA 305): requests, and who answers that it has no node-ID."""

from dbc.canopen import FASTSCAN_ALL, LSS_BYTES, LSS_REQUEST_COB_ID, LSS_RESPONSE_COB_ID, Lss
from dbc.frame import Frames, one_frame, received


def lss_request(command: int, *values: int) -> bytes:
    """Return a request of LSS: eight bytes."""
    return bytes((command, *values)).ljust(LSS_BYTES, b"\0")


def fastscan(number: int, bit: int, place: int, following: int) -> bytes:
    """Return the question to boards without node-ID whether `number` is theirs down to `bit`."""
    return lss_request(Lss.FASTSCAN, *number.to_bytes(4, "little"), bit, place, following)


def anybody_without_node_id() -> Frames:
    """Return the request that every board without node-ID answers."""
    return one_frame(LSS_REQUEST_COB_ID, fastscan(0, FASTSCAN_ALL, 0, 0))


def has_answer(arrived: Frames) -> bool:
    """Tell whether a board answers `anybody_without_node_id`."""
    plain = received(arrived)
    return bool(((plain["can_id"] == LSS_RESPONSE_COB_ID) & (plain["data"][:, 0] == Lss.IDENTIFIED)).any())
