"""CAN FD on a real kernel, judged by can-utils."""

import re
import select
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bus.link import Link, open_link
from canskin.errors import BusError
from dbc.frame import BRS, ESI, EXTENDED, FD, Frames, frames
from tests.processes import Processes
from tests.vcan.chain import ip_link

DATA = bytes(range(64))


@pytest.fixture
def link() -> Iterator[Link]:
    opened = open_link("socketcan", "vcan0", 1_000_000, fd=True)
    yield opened
    opened.close()


def fd_frame(can_id: int, data: bytes, flags: int) -> Frames:
    frame = frames(1)
    frame["can_id"], frame["length"], frame["flags"] = can_id, len(data), FD | flags
    frame["data"][0, : len(data)] = tuple(data)
    return frame


def test_candump_logs_the_fd_frames_a_link_sends(link: Link, tmp_path: Path) -> None:
    sent = [fd_frame(0x181, DATA, BRS), fd_frame(0x182, DATA[:12], 0), fd_frame(0x12345678, DATA[:20], EXTENDED | BRS)]
    with Processes(tmp_path) as processes:
        processes.start("candump", "candump", "-L", "vcan0")

        def listens() -> bool:
            link.send(fd_frame(0x7FF, b"", 0))
            return processes.log("candump").stat().st_size > 0

        processes.until(listens, "candump's first frame")
        assert link.send(np.concatenate(sent)) == len(sent)
        processes.until(lambda: "12345678##" in processes.log("candump").read_text(), "the last frame")
        log = processes.log("candump").read_text()
    logged = re.findall(r"^\(\d+\.\d+\) vcan0 (\w+)##(.)(\w+)$", log, re.MULTILINE)
    # Flag 4 says that it is an FD frame; newer kernels set it.
    assert [(can_id, int(flags, 16) & 0b11, data) for can_id, flags, data in logged] == [
        ("181", 1, DATA.hex().upper()),
        ("182", 0, DATA[:12].hex().upper()),
        ("12345678", 1, DATA[:20].hex().upper()),
    ]


def test_a_link_receives_the_fd_frames_cansend_sends(link: Link) -> None:
    link.receive()
    subprocess.run(["cansend", "vcan0", f"181##3{DATA.hex()}"], check=True)
    assert select.select([link], [], [], 10)[0]
    arrived = link.receive()
    assert arrived["flags"].tolist() == [FD | BRS | ESI]
    assert arrived["data"][0].tobytes() == DATA


def test_an_interface_without_fd_is_refused_in_one_line() -> None:
    ip_link("set", "vcan3", "down")
    ip_link("set", "vcan3", "mtu", "16", "up")
    try:
        with pytest.raises(BusError, match=r"vcan3.*CAN FD.*mtu 72"):
            open_link("socketcan", "vcan3", 1_000_000, fd=True)
        open_link("socketcan", "vcan3", 1_000_000).close()
    finally:
        ip_link("set", "vcan3", "down")
        ip_link("set", "vcan3", "mtu", "72", "up")
