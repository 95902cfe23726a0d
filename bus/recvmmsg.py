"""Many datagrams per system call: recvmmsg(2) and sendmmsg(2) on arrays; Python's socket module has neither."""

import ctypes
import errno
import os
import socket
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shell.compiled import njit

#: Control data of one message, each after a cmsghdr of 16 bytes: a time stamp of the kernel (timespec, 16), of the
#: device (three timespecs, 48), and a drop count (u32 and padding).
_CONTROL_BYTES: Final = 128
SO_TIMESTAMPNS: Final = 35
SO_TIMESTAMPING: Final = 37
SO_RXQ_OVFL: Final = 40
#: Flags of SO_TIMESTAMPING: raw stamps of the device alone; the kernel's come by SO_TIMESTAMPNS.
DEVICE_STAMPS: Final = 1 << 2 | 1 << 6


class _Header(ctypes.Structure):
    """``struct msghdr``."""

    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_length", ctypes.c_uint),
        ("vectors", ctypes.c_void_p),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_length", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    )


class _Message(ctypes.Structure):
    """``struct mmsghdr``."""

    _fields_ = (("header", _Header), ("length", ctypes.c_uint))


class _Vector(ctypes.Structure):
    """``struct iovec``."""

    _fields_ = (("base", ctypes.c_void_p), ("length", ctypes.c_size_t))


class Received(NamedTuple):
    """A batch of datagrams: views of the buffers, valid until the next batch.

    Attributes
    ----------
    rows : array of uint8, shape (n, size)
    lengths, flags : arrays of int, shape (n,)
        Bytes and MSG_* flags of each datagram.
    time_ns : array of int64, shape (n,)
        Wall-clock time of arrival, 0 if the socket gives none.
    device_ns : array of int64, shape (n,)
        Time stamp of the device, on a clock of its own, 0 if it gives none.
    dropped : int or None
        Total number of datagrams that the socket has dropped; None if the batch has no count.
    """

    rows: npt.NDArray[np.uint8]
    lengths: npt.NDArray[np.uint32]
    flags: npt.NDArray[np.int32]
    time_ns: npt.NDArray[np.int64]
    device_ns: npt.NDArray[np.int64]
    dropped: int | None


class BatchSocket:
    """Buffers for batches of `count` datagrams of `size` bytes on one socket; the caller closes the socket."""

    def __init__(self, connection: socket.socket, count: int, size: int) -> None:
        self._socket = connection
        self._rows = np.zeros((count, size), np.uint8)
        self._control = np.zeros((count, _CONTROL_BYTES), np.uint8)
        self._vectors = (_Vector * count)()
        self._messages = (_Message * count)()
        for place in range(count):
            self._vectors[place].base = self._rows.ctypes.data + place * size
            header = self._messages[place].header
            header.vectors = ctypes.addressof(self._vectors) + place * ctypes.sizeof(_Vector)
            header.vector_count = 1
        self._sizes = _field(self._vectors, _Vector, _Vector.length.offset, np.dtype(np.uintp))
        start = _Message.header.offset
        self._controls = _field(self._messages, _Message, start + _Header.control.offset, np.dtype(np.uintp))
        self._control_sizes = _field(
            self._messages, _Message, start + _Header.control_length.offset, np.dtype(np.uintp)
        )
        self._flags = _field(self._messages, _Message, start + _Header.flags.offset, np.dtype(np.int32))
        self._lengths = _field(self._messages, _Message, _Message.length.offset, np.dtype(np.uint32))
        self._libc = ctypes.CDLL(None, use_errno=True)

    def receive(self) -> Received:
        """Return the waiting datagrams; never wait.

        Raises
        ------
        OSError
            Any error of recvmmsg except an empty queue.
        """
        self._sizes[:] = self._rows.shape[1]
        self._controls[:] = self._control.ctypes.data + _CONTROL_BYTES * np.arange(len(self._rows))
        self._control_sizes[:] = _CONTROL_BYTES
        count = self._call("recvmmsg", len(self._rows), None)
        return self.received(count)

    def received(self, count: int) -> Received:
        """Return the first datagrams of the buffers."""
        told = _read_control(self._control[:count], self._control_sizes[:count])
        return Received(self._rows[:count], self._lengths[:count], self._flags[:count], *told)

    def send(self, rows: npt.NDArray[np.uint8], lengths: npt.NDArray[np.integer]) -> int:
        """Send datagrams; return the number that the socket accepted.

        Raises
        ------
        OSError
            Any error of sendmmsg except a full queue.
        """
        count = min(len(rows), len(self._rows))
        self._rows[:count] = rows[:count]
        self._sizes[:count] = lengths[:count]
        self._controls[:] = 0
        self._control_sizes[:] = 0
        return self._call("sendmmsg", count)

    def _call(self, name: str, count: int, *more: Any) -> int:
        if not count:
            return 0
        done = getattr(self._libc, name)(
            self._socket.fileno(), ctypes.byref(self._messages), count, socket.MSG_DONTWAIT, *more
        )
        if done >= 0:
            return int(done)
        code = ctypes.get_errno()
        if code in {errno.EAGAIN, errno.ENOBUFS, errno.EINTR}:
            return 0
        raise OSError(code, os.strerror(code))


def _field(records: Any, record: Any, offset: int, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Return one field of an array of C structures as an array."""
    columns = np.dtype({"names": ["field"], "formats": [dtype], "offsets": [offset], "itemsize": ctypes.sizeof(record)})
    view: npt.NDArray[Any] = np.frombuffer(records, columns)["field"]
    return view


def _read_control(
    control: npt.NDArray[np.uint8], sizes: npt.NDArray[np.uintp]
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], int | None]:
    """Return kernel and device stamps, 0 without, and the drop count."""
    time_ns, device_ns = np.zeros((2, len(sizes)), np.int64)
    dropped = _read_all(control.view(np.int64), sizes, time_ns, device_ns)
    return time_ns, device_ns, None if dropped < 0 else dropped


@njit(cache=True, nogil=True)
def _read_all(
    words: npt.NDArray[np.int64],
    sizes: npt.NDArray[np.uintp],
    time_ns: npt.NDArray[np.int64],
    device_ns: npt.NDArray[np.int64],
) -> int:
    """Write the stamps into arrays of zeros; return the drop count, -1 without one.

    Linux writes stamps and count in this order and may leave out any.
    """
    dropped = -1
    for place in range(len(sizes)):
        told, size = words[place], int(sizes[place])
        count_at = 0
        # cmsghdr: length 8, level 4, type 4; so word 1 is level and type
        if size >= 32 and told[1] >> 32 == SO_TIMESTAMPNS:
            time_ns[place] = told[2] * 1_000_000_000 + told[3]
            count_at = 4
            if size >= 96 and told[5] >> 32 == SO_TIMESTAMPING:
                # struct scm_timestamping: the third is the device's.
                device_ns[place] = told[10] * 1_000_000_000 + told[11]
                count_at = 12
        if size >= 8 * count_at + 20 and told[count_at + 1] >> 32 == SO_RXQ_OVFL:
            dropped = max(dropped, told[count_at + 2] & 0xFFFFFFFF)
    return dropped
