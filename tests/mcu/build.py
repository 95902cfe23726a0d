"""Programs of emulated boards: the export of a skin compiled with its example port, and an slcan adapter."""

import os
import subprocess
import zlib
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dbc.contract import Contract
from dbc.generate import write_files
from nodes.firmware.export import export_files

#: Boards of the emulated machine: its PCI bus has four interrupt lines, and the adapter takes one.
BOARDS: Final = 3
#: Where `tests/mcu/run` has unpacked QEMU and the compiler.
TOOLS: Final = Path(os.environ.get("SKIN_MCU", "/nonexistent"))
_HERE: Final = Path(__file__).parent / "c"
_GCC: Final = "arm-none-eabi-gcc"
_PROCESSOR: Final = ("-mcpu=cortex-a15", "-mthumb")
#: A filter at 1 kHz needs a floating point unit.
_SOFT, _HARD = ("-mfloat-abi=soft",), ("-mfloat-abi=hard", "-mfpu=vfpv4-d16")
_FLAGS: Final = (
    *("-std=c99", "-Os", "-g", "-Wall", "-Wextra", "-Werror", "-ffunction-sections", "-fdata-sections"),
    *("-mno-unaligned-access", "-ffp-contract=off", "-fno-math-errno"),
    # A loop of our memcpy must not become a call of memcpy.
    "-fno-tree-loop-distribute-patterns",
)
_LINK: Final = ("-nostartfiles", "-nodefaultlibs", "-Wl,--gc-sections", "-Wl,--no-warn-rwx-segments")


@dataclass(frozen=True)
class Images:
    """Folder with ``board-N.elf``, ``boot-N.elf`` of each board, and ``adapter.elf``."""

    folder: Path
    contract: Contract

    def board(self, cpu: int) -> Path:
        """Return the program of a board."""
        return self.folder / f"board-{cpu}.elf"

    def program(self, cpu: int) -> bytes:
        """Return what the processor of a board runs."""
        flat = self.folder / f"board-{cpu}.bin"
        _run("arm-none-eabi-objcopy", "-O", "binary", self.board(cpu), flat)
        return flat.read_bytes()

    def symbols(self, cpu: int) -> dict[str, int]:
        """Return the addresses of the program of a board by their names."""
        lines = (line.split() for line in _run("arm-none-eabi-nm", self.board(cpu)).splitlines())
        return {name: int(address, 16) for address, _, name in lines}

    def sizes(self) -> tuple[int, int]:
        """Return bytes of flash memory and of RAM, without stacks, that the program of a board takes."""
        text, data, bss = map(int, _run("arm-none-eabi-size", self.board(1)).splitlines()[1].split()[:3])
        symbols = self.symbols(1)
        return text + data, data + bss - (symbols["__interrupt_stack"] - symbols["__stack_bottom"])


def tool_environment() -> dict[str, str]:
    """Return the environment of a program that `tests/mcu/run` has unpacked."""
    libraries = (*TOOLS.glob("usr/lib/*-linux-gnu"), *TOOLS.glob("lib/*-linux-gnu"))
    return os.environ | {
        "PATH": f"{TOOLS / 'usr/bin'}:{os.environ['PATH']}",
        "LD_LIBRARY_PATH": ":".join(map(str, libraries)),
    }


def build(contract: Contract, folder: Path) -> Images:
    """Export the boards of a skin, compile them with the example port, and link them for each processor."""
    write_files(export_files(contract, contract.nodes), folder)
    ports = folder / "ports"
    is_fd = contract.layout.bus[0].fd
    processor = (*_PROCESSOR, *(_HARD if contract.layout.sending == "steps" else _SOFT))
    slave = sorted([*folder.glob("src/*.c"), *folder.glob("src/slave/*.c"), *folder.glob("src/steps/*.c")])
    slave += [each for each in folder.glob("boards/all/*.c") if each.name != "OD.c"]
    common = [ports / name for name in ("memory.c", "virt/start.S", "virt/virt.c")]
    flash = ports / "flash_cfi.c"
    board = [
        ports / name
        for name in ("main.c", "queues.c", "can_ctucanfd.c" if is_fd else "can_sja1000.c", "virt/converters.c")
    ]
    adapter = [ports / name for name in ("queues.c", "can_ctucanfd.c")]
    # A block of four segments fits into the FIFO of an SJA1000: it is not lost when the processor stands still.
    options = [
        f"-DSKIN_BLOCK_SEGMENTS={16 if is_fd else 4}u",
        f"-DSKIN_FRAME_BYTES={64 if is_fd else 8}",
        f"-DVIRT_FD={int(is_fd)}",
    ]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        compiled = _Objects(folder, processor, pool)
        of_slave, of_common = compiled(slave, options), compiled(common, options)
        of_board, of_boot = compiled([*board, flash], options), compiled([ports / "boot.c", flash], options)
        of_adapter = compiled([*adapter, _HERE / "adapter.c"], ["-DPORT_RECEIVED=2048u", f"-DBOARDS={BOARDS}u"])
        done = []
        for cpu in range(1, BOARDS + 1):
            objects = [*of_common, *of_slave]
            done.append(
                pool.submit(
                    _link, folder, processor, f"board-{cpu}", 0x41000000 + cpu * 0x100000, [*objects, *of_board]
                )
            )
            done.append(
                pool.submit(_link, folder, processor, f"boot-{cpu}", 0x42000000 + cpu * 0x100000, [*objects, *of_boot])
            )
        done.append(pool.submit(_link, folder, processor, "adapter", 0x40100000, [*of_common, *of_adapter]))
        for each in done:
            each.result()
    return Images(folder, contract)


class _Objects:
    """Compiles sources in parallel."""

    def __init__(self, folder: Path, processor: Sequence[str], pool: ThreadPoolExecutor) -> None:
        self._folder, self._processor, self._pool = folder, processor, pool
        self._include = [f"-I{path}" for path in (folder / "src", *folder.glob("src/*/"), folder / "boards/all")]
        self._include += [
            f"-I{folder / 'ports'}",
            f"-I{folder / 'ports/virt'}",
            f"-isystem{TOOLS / 'usr/include/newlib'}",
        ]

    def __call__(self, texts: Iterable[Path], options: Sequence[str]) -> list[Path]:
        return list(self._pool.map(lambda text: self._compile(text, options), texts))

    def _compile(self, text: Path, options: Sequence[str]) -> Path:
        mark = zlib.crc32(" ".join(options).encode())
        made = self._folder / f"{text.stem}-{mark:x}.o"
        _run(_GCC, *self._processor, *_FLAGS, *options, *self._include, "-c", text, "-o", made)
        return made


def _link(folder: Path, processor: Sequence[str], name: str, origin: int, objects: Sequence[Path]) -> None:
    multilib = _run(_GCC, *processor, "-print-multi-directory").strip()
    libraries = (f"-L{TOOLS / 'usr/lib/arm-none-eabi/newlib' / multilib}", "-lm", "-lgcc")
    script = ("-T", folder / "ports/virt/board.ld", f"-Wl,--defsym=ORIGIN_OF_IMAGE={origin:#x}")
    _run(_GCC, *processor, *_LINK, *script, *objects, *libraries, "-o", folder / f"{name}.elf")


def _run(*command: str | Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=tool_environment())
    assert done.returncode == 0, f"{' '.join(map(str, command))}: {done.stderr}"
    return done.stdout
