"""Processor time of processes, from the kernel's table."""

import os
from pathlib import Path
from typing import Final, NamedTuple

#: Places of utime and stime in /proc/PID/stat after the name of the program (proc(5): fields 14 and 15).
_TIMES: Final = slice(11, 13)


class ProcessorTime(NamedTuple):
    """Time that a process has spent on processors, user and system, since its start."""

    pid: int
    spent_s: float


def processor_time(pid: int) -> ProcessorTime | None:
    """Return the processor time of a process, None where it has none or the system does not tell."""
    try:
        about = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return None
    ticks = sum(map(int, about.rpartition(")")[2].split()[_TIMES]))
    return ProcessorTime(pid, ticks / os.sysconf("SC_CLK_TCK"))


def ratios(before: dict[str, ProcessorTime], after: dict[str, ProcessorTime], wall_s: float) -> dict[str, float]:
    """Return the processor time / wall time of each process that there is at the end; one processor is 1.

    A process that was started again in between counts from its start.
    """
    spent_s = {
        name: end.spent_s - (before[name].spent_s if name in before and before[name].pid == end.pid else 0.0)
        for name, end in after.items()
    }
    return {name: round(each / wall_s, 3) for name, each in spent_s.items()} if wall_s > 0 else {}
