"""Logs made here that hold what logs of other programs hold, beside plain frames."""

import struct
from typing import Final

from can.io import blf


def blf_object(kind: int, body: bytes, time_ns: int = 0) -> bytes:
    head = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 32, 1, 32 + len(body), kind)
    return head + blf.OBJ_HEADER_V1_STRUCT.pack(blf.TIME_ONE_NANS, 0, 0, time_ns) + body


def blf_file(objects: list[bytes], count: int | None = None) -> bytes:
    """Return a log of one container that is not packed; `count` is the number of objects in its head."""
    content = b"".join(each + bytes(len(each) % 4) for each in objects)
    size = 32 + len(content)
    head = [b"LOGG", 144, 5, 0, 0, 0, 2, 6, 8, 1, 144 + size, 144 + size, len(objects) if count is None else count]
    container = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, size, blf.LOG_CONTAINER)
    container += blf.LOG_CONTAINER_STRUCT.pack(blf.NO_COMPRESSION, len(content))
    return blf.FILE_HEADER_STRUCT.pack(*head, *[0] * 17).ljust(144, b"\0") + container + content


def blf_frame(number: int) -> bytes:
    body = blf.CAN_MSG_STRUCT.pack(1, 0, 8, 0x181, struct.pack("<Q", number))
    return blf_object(blf.CAN_MESSAGE, body, 10_000_000 * number)


ASC: Final = b"""date Fri Nov 27 10:00:00.000 am 2026
base hex  timestamps %s
internal events logged
// version 13.0.0
Begin Triggerblock Fri Nov 27 10:00:00.000 am 2026
   0.000000 Start of measurement
   0.100000 1  181             Rx   d 8 01 02 03 04 05 06 07 08
   0.100000 CAN 1 Status:chip status error active
   0.100000 1  182             TxRq d 1 01
   0.100000 1  182             Tx   d 1 01
   0.100000 1  ErrorFrame
   0.100000 1  Statistic: D 12 R 0 XD 0 XR 0 E 0 O 0 B 1.2%%
   0.100000 CANFD   1 Rx        183                                   1 0 8  8 01 02 03 04 05 06 07 08 0 0 3000 0
   0.100000 2  7FFx            Rx   r 4
End TriggerBlock
"""
CORPUS: Final = {
    "candump.log": (
        b"# a comment\n; another\n\n(1.0) can0 181#0102030405060708\n(1.1) can0 314#1122334455667788_B\n"
        b"(1.2) can0 315#R8_E\n(1.3) can0 316#R5\n(1.4) can0 317##31122\n(1.5) can0 00123#81:00:12345678#112233\n"
        b"(1.6) can0 20000088#00000E0000000000\n(1.7) can0 2000000C#0008000000000000 R\n(1.8) can0 01ABCDEF#01 T\n"
    ),
    "absolute.asc": ASC % b"absolute",
    "relative.asc": ASC % b"relative",
    "errors-1-1.trc": (
        b";$FILEVERSION=1.1\n;$STARTTIME=46353.5\n;\n     1)         1.0  Rx         0181  2  01 02\n"
        b"     2)         2.0  Error      0008  4  00 19 08 08\n     3)         3.0  Warng  FFFFFFFF  4  00 00 00 04\n"
        b"     4)         4.0  Tx     000007FF  1  RTR\n"
    ),
    "errors-1-3.trc": (
        b";$FILEVERSION=1.3\n;$STARTTIME=46353.5\n;\n     1)         1.0 1  Rx        0181 -  2    01 02\n"
        b"     2)         2.0 2  Error     0008 -  4    00 19 08 08\n"
    ),
    "errors-2-1.trc": (
        b";$FILEVERSION=2.1\n;$STARTTIME=46353.5\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n;\n"
        b"      1         1.000 DT  1     0181 Rx -  2    01 02\n"
        b"      2         2.000 ER  1        - Rx -  5    04 00 02 00 00\n"
        b"      3         3.000 ST  1        - Rx -  4    00 00 00 08\n      4         4.000 FB  1     0182 Rx -  9    "
        + b"00 " * 12
        + b"\n      5         5.000 RR  1     0183 Rx -  8\n      6         6.000 XX  1     0183 Rx -  8\n"
    ),
    "kinds.blf": blf_file(
        [
            blf_frame(0),
            blf_object(2, struct.pack("<HHL", 1, 0, 0)),
            blf_object(blf.CAN_ERROR_EXT, struct.pack("<HHL", 1, 0, 0).ljust(blf.CAN_ERROR_EXT_STRUCT.size, b"\0")),
            blf_object(104, b"\x01".ljust(64, b"\0")),
            blf_object(96, bytes(40)),
            blf_object(4, bytes(40)),
        ]
    ),
}
