"""What is told of a link between Python and compiled code, and what compiled code calls of the C library."""

import errno
import socket
from typing import Any, Final

from numba import types
from numba.np.numpy_support import carray

from dbc.frame_fields import Integers
from shell.compiled import njit

#: What is told of a link: its descriptor (-1: none); who reads it, `PYTHON`, `PACKETS` or `DATAGRAMS`; whether it was
#: readable; the number of frames that were read; whether its socket has failed; state of its controller; frames that
#: it has dropped; whether Python has to look at the frames that were read; bound of the error of the clock of their
#: time stamps, or `NO_STAMPS`; of that bound the part of the device's clock; wall clock minus CLOCK_MONOTONIC. Then
#: follow the own frames that came back, by port.
DESCRIPTOR, READER, IS_READY, CAME, HAS_FAILED, STATE, DROPPED, NEEDS_LOOK = range(8)
STAMP_ERROR, DEVICE_ERROR, OFFSET, RETURNED = range(8, 12)
#: Who reads a link: its owner, or compiled code, packets of `bus.protocol` or datagrams of `bus.datagrams`.
PYTHON, PACKETS, DATAGRAMS = range(3)
#: The error of a clock that gives no time stamps.
NO_STAMPS: Final = -1


CLOCK_REALTIME, CLOCK_MONOTONIC = 0, 1
SECOND_NS: Final = 1_000_000_000
DONTWAIT: Final = int(socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL)
_NOTHING: Final = (errno.EAGAIN, errno.EINTR, errno.ENOBUFS)

_clock_gettime: Any = types.ExternalFunction("clock_gettime", types.int32(types.int32, types.intp))
_errno: Any = types.ExternalFunction("__errno_location", types.CPointer(types.int32)())  # type: ignore[no-untyped-call]


@njit(cache=True, nogil=True)
def has_failed() -> bool:
    """Tell whether the last call of the C library has failed for another reason than that it would have to wait."""
    return carray(_errno(), 1)[0] not in _NOTHING


@njit(cache=True, nogil=True)
def clock_ns(clock: int, span: Integers) -> int:
    """Return the time of a clock; `span` is room for a ``struct timespec``."""
    _clock_gettime(clock, span.ctypes.data)
    return int(span[0] * SECOND_NS + span[1])
