"""An emulated machine: boards with a processor, a CAN controller and a flash memory each, and an slcan adapter."""

import contextlib
import itertools
import json
import os
import re
import signal
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from bus.link import Link, open_link
from dbc.contract import Contract
from dbc.dictionary import REVISION
from dbc.program import Program
from dbc.slots import sealed
from tests.mcu.build import BOARDS, TOOLS, Images, tool_environment

#: Longest wait for anything that a board does.
PATIENCE_S: Final = 60.0
#: Of the flash memory: all, the part of a board, and a sector (``ports/virt/virt.h``, ``ports/flash_cfi.h``).
FLASH_BYTES, BOARD_BYTES, SECTOR_BYTES = 1 << 26, 1 << 21, 1 << 18
#: Switches of board n: its node-ID (``ports/virt/virt.h``).
SWITCHES, SWITCHES_STEP = 0x43000000, 0x100
#: Bytes of a stack that were never used (``ports/virt/start.S``).
PAINT: Final = b"\xa5"
#: The instruction of Thumb code.
BRANCH_TO_ITSELF: Final = 0xE7FE
#: QEMU may wait for ever for something that it has: a processor that writes to the flash memory may take the note that
#: was meant to wake the main loop. A signal wakes the main loop, which does nothing else with it.
WAKING_S: Final = 0.01
_ERASED: Final = b"\xff"


def made_with(images: Images, cpu: int) -> Program:
    """Return the program that a board was made with."""
    return program_of(images.contract, "1.0", images.program(cpu))


def program_of(contract: Contract, version: str, data: bytes) -> Program:
    """Return a program for the boards of a skin."""
    device = contract.layout.device
    return Program(device.vendor_id, device.product_code, REVISION, version, data)


class Machine:
    """Boards that run; without power between `cut_power` and `start`.

    Parameters
    ----------
    has_switches : bool
        Whether each board has switches for its node-ID; else LSS gives the node-ID.

    Attributes
    ----------
    terminal : str
        The adapter's terminal, while the machine has power.
    """

    def __init__(self, images: Images, folder: Path, *, has_switches: bool = True) -> None:
        self.images, self.folder = images, folder
        self.terminal = ""
        self._has_switches = has_switches
        self._flash, self._log = folder / "flash.img", folder / "boards.log"
        self._process: subprocess.Popen[bytes] | None = None
        self._held = -1
        self._ended = threading.Event()
        self._waking = threading.Thread()
        with self._flash.open("wb") as file:
            file.truncate(FLASH_BYTES)
            for cpu in range(1, BOARDS + 1):
                memory = bytearray(_ERASED * BOARD_BYTES)
                slot = sealed(0, 0, made_with(images, cpu).image)
                memory[: len(slot)] = slot
                file.seek(cpu * BOARD_BYTES)
                file.write(memory)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.cut_power()

    @property
    def said(self) -> str:
        """What the boards have said since the newest start."""
        return self._log.read_text(errors="replace") if self._log.exists() else ""

    def start(self) -> None:
        """Give power, and wait until all boards run."""
        self._log.unlink(missing_ok=True)
        self._process = subprocess.Popen(
            self._command(),
            env=tool_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        assert self._process.stdout is not None
        lines = iter(self._process.stdout.readline, b"")
        found = next(filter(None, (re.search(r"/dev/pts/\d+", line.decode()) for line in lines)), None)
        assert found, "QEMU does not start"
        self.terminal = found[0]
        # QEMU looks once a second whether a terminal that was closed is open again: hold it open.
        self._held = os.open(self.terminal, os.O_RDWR | os.O_NOCTTY)
        self._ended.clear()
        self._waking = threading.Thread(target=self._wake, args=(self._process,))
        self._waking.start()
        self.until(lambda: self.said.count("\n") >= BOARDS, "all boards to start")

    def cut_power(self) -> None:
        """End the machine at once."""
        if self._process is not None:
            self._ended.set()
            self._waking.join()
            os.close(self._held)
            self._process.kill()
            self._process.communicate()
            self._process = None
            assert "FAULT" not in self.said, self.said

    def until(self, is_so: Callable[[], bool], what: str) -> None:
        """Wait for something that the boards do."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not is_so():
            assert self._process is not None
            assert self._process.poll() is None, self._process.communicate()
            assert time.monotonic() < give_up_s, f"waited {PATIENCE_S:g} s for {what}; the boards said: {self.said}"
            time.sleep(0.02)

    @contextlib.contextmanager
    def link(self) -> Iterator[Link]:
        """Connect to the bus through the adapter."""
        bus = self.images.contract.layout.bus[0]
        link = open_link(
            *("slcan", self.terminal, bus.bitrate),
            fd=bus.fd,
            data_bitrate=bus.data_bitrate if bus.fd else None,
            options={"sleep_after_open": 0.0},
        )
        try:
            yield link
        finally:
            link.close()

    def order(self, *lines: str) -> None:
        """Give the adapter orders of its own (``c/adapter.c``)."""
        os.write(self._held, "".join(f"{line}\r" for line in lines).encode())

    def poke(self, address: int, word: int) -> None:
        """Write a word into the memory of the boards."""
        self.order(f"W{address:08x}{word:08x}")

    def hang(self, address: int, *meanwhile: str) -> None:
        """Have a board hang in a function of its program; with orders `meanwhile` it goes on after them."""
        function = address & ~1  # the lowest bit says that the function is in Thumb code
        word = function & ~3
        (before,) = struct.unpack("<I", self.peek(word, 4))
        shift = 16 if function & 2 else 0
        self.poke(word, before & ~(0xFFFF << shift) | BRANCH_TO_ITSELF << shift)
        if meanwhile:
            self.order(*meanwhile)
            self.poke(word, before)

    @property
    def on_bus(self) -> tuple[str | Path, ...]:
        """Arguments of the verbs of ``skin node``."""
        layout = self.images.contract.layout
        path = self.images.folder / "layout.toml"
        adapter = ("-i", "slcan", "-c", self.terminal, "--bus-option", "sleep_after_open=0.0")
        return "--bus", layout.bus[0].name, *adapter, "--layout", path

    def peek(self, address: int, count: int) -> bytes:
        """Return bytes of the memory of the boards."""
        path = self.folder / "memory.bin"
        with socket.socket(socket.AF_UNIX) as monitor:
            monitor.connect(str(self.folder / "monitor"))
            with monitor.makefile("rw") as talk:
                talk.readline()
                for command, arguments in (
                    ("qmp_capabilities", {}),
                    ("pmemsave", {"val": address, "size": count, "filename": str(path)}),
                ):
                    talk.write(json.dumps({"execute": command, "arguments": arguments}) + "\n")
                    talk.flush()
                    answer: dict[str, Any] = {}
                    while "return" not in answer:
                        answer = json.loads(talk.readline())
                        assert "error" not in answer, answer
        return path.read_bytes()

    def stack_bytes(self, cpu: int) -> int:
        """Return the most bytes that main program and interrupts of a board had on their stacks together."""
        symbols = self.images.symbols(cpu)
        ends = [symbols[name] for name in ("__stack_bottom", "__stack", "__interrupt_stack")]
        stacks = [self.peek(low, high - low) for low, high in itertools.pairwise(ends)]
        return sum(len(stack) - (len(stack) - len(stack.lstrip(PAINT))) // 4 * 4 for stack in stacks)

    def _wake(self, process: subprocess.Popen[bytes]) -> None:
        while not self._ended.wait(WAKING_S):
            process.send_signal(signal.SIGALRM)

    def _command(self) -> Sequence[str]:
        control = "ctucan_pci,canbus0=bus,canbus1=none"
        boards = control if self.images.contract.layout.bus[0].fd else "kvaser_pci,canbus=bus"
        devices: list[str] = []
        for cpu in range(1, BOARDS + 1):
            devices += ["-device", f"loader,file={self.images.folder / f'boot-{cpu}.elf'}"]
            devices += ["-device", f"{boards},addr={cpu}"]
            if self._has_switches:
                place = f"addr={SWITCHES + cpu * SWITCHES_STEP:#x}"
                devices += ["-device", f"loader,{place},data={cpu},data-len=4"]
        return [
            # The machine ends with the test, however that ends.
            *(
                "setpriv",
                "--pdeathsig",
                "KILL",
                "qemu-system-arm",
                "-M",
                "virt,highmem=off,gic-version=2",
                "-cpu",
                "cortex-a15",
            ),
            *("-smp", str(BOARDS + 1), "-m", "128M", "-accel", "tcg,thread=multi", "-display", "none", "-nodefaults"),
            *("-L", str(TOOLS / "usr/share/qemu"), "-object", "can-bus,id=bus", "-object", "can-bus,id=none", *devices),
            *("-device", f"{control},addr={BOARDS + 1}", "-chardev", "pty,id=adapter", "-serial", "chardev:adapter"),
            *("-chardev", f"file,id=log,path={self._log}"),
            *("-semihosting-config", "enable=on,target=native,chardev=log"),
            *("-qmp", f"unix:{self.folder / 'monitor'},server=on,wait=off"),
            *("-drive", f"if=pflash,unit=1,format=raw,file={self._flash}"),
            *("-device", f"loader,file={self.images.folder / 'adapter.elf'},cpu-num=0"),
        ]
