"""``skin doctor time``: what the clocks and the scheduler of this host do to a skin."""

import ctypes
import os
import re
import select
import struct
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from canskin.errors import InputError, RunError
from canskin.peers import ORDINARY, REAL_TIME
from shell.service import StopSignal, request_real_time, way_to_real_time
from shell.terminal import print_json, print_table
from skin.layout import Layout
from skin.ranges import require_above_zero

SECONDS_MAX: Final = 3600.0
#: Clock sources that the kernel reads from a slow device, or that count ticks of the timer.
SLOW_CLOCKS: Final = ("hpet", "acpi_pm", "pit", "jiffies", "refined-jiffies")
#: Readings of the clock, to time one.
_READINGS: Final = 1000
#: A timer of this resolution ends waits of any length, not at ticks.
_FINE_S: Final = 1e-6
#: Return value of adjtimex(2): the clock is not synchronised.
_TIME_ERROR: Final = 5
#: ``struct timex`` up to `status`: modes, offset, frequency, largest and estimated error in microseconds.
_TIMEX: Final = struct.Struct("@Illll")
_TIMEX_BYTES: Final = 512
#: Bit of ``CapEff`` in proc(5), see capabilities(7).
_CAP_SYS_NICE: Final = 23


@dataclass(frozen=True)
class Setting:
    """A setting of the host; `mend` is a command, or what to change, if another value is better for a skin."""

    name: str
    value: str
    mend: str = ""
    gain: str = ""


def measure(layout: Layout, seconds: float, *, as_json: bool) -> None:
    """Wait for the SYNC periods of a layout as the gateway does, with a service's scheduling, and print how late.

    Raises
    ------
    InputError
        If this is no Linux, or `seconds` is no such time.
    RunError
        If `seconds` is shorter than two periods.
    """
    if sys.platform != "linux":
        raise InputError(f"expected Linux, got {sys.platform}: run 'skin doctor time' on the gateway's host")
    require_above_zero("--seconds", seconds, SECONDS_MAX)
    period_s = layout.sync.period_s
    scheduling = request_real_time("doctor")
    late_s = wake_ups(period_s, seconds, StopSignal().install())
    if len(late_s) < 2:
        raise RunError(f"no two SYNC periods of {1e3 * period_s:g} ms were measured: expected a longer --seconds")
    middle_s, most_s, worst_s = np.percentile(late_s, (50, 99, 100))
    figures = {
        "period_ms": 1e3 * period_s,
        "wake_ups": len(late_s),
        "late_p50_us": 1e6 * middle_s,
        "late_p99_us": 1e6 * most_s,
        "late_max_us": 1e6 * worst_s,
        "jitter_us": 1e6 * np.std(np.diff(late_s)),
        "later_than_half_a_period": int(np.count_nonzero(late_s > period_s / 2)),
        "clock_reading_ns": clock_reading_ns(),
        "timer_resolution_ns": 1e9 * time.clock_getres(time.CLOCK_MONOTONIC),
    }
    found = settings(scheduling)
    if as_json:
        print_json({**figures, "settings": found})
        return
    print_table(["", "measured"], ([name, f"{value:.6g}"] for name, value in figures.items()))
    print()
    print_table(["setting", "now"], ([each.name, each.value] for each in found))
    for each in found:
        if each.mend:
            print(f"\n{each.name}: {each.mend}\n    gains: {each.gain}")


def wake_ups(period_s: float, seconds: float, stop: StopSignal) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Wait for the ends of periods, and return how late each wait ended, s; periods that passed meanwhile are skipped.

    `select.select`, because the gateway waits with it.
    """
    late_s = []
    due_s = time.monotonic() + period_s
    end_s = due_s + seconds
    while due_s < end_s and not stop.is_set():
        while (left_s := due_s - time.monotonic()) > 0:
            select.select([], [], [], left_s)
        late_s.append(-left_s)
        due_s += period_s * (1 + late_s[-1] // period_s)
    return np.array(late_s)


def clock_reading_ns() -> float:
    """Return how long a reading of CLOCK_MONOTONIC takes, ns."""
    begin_ns = time.monotonic_ns()
    for _ in range(_READINGS):
        end_ns = time.monotonic_ns()
    return (end_ns - begin_ns) / _READINGS


def settings(scheduling: str) -> list[Setting]:
    """Read the settings of this host that decide how exactly it keeps time.

    Parameters
    ----------
    scheduling : str
        What `request_real_time` has obtained; empty if it was not called.
    """
    return [_right(scheduling), _clock(), _synchronised(), _timer(), _governor(), _preemption()]


def _right(scheduling: str) -> Setting:
    import resource  # of Unix alone

    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    found = re.search(r"^CapEff:\s*(\w+)", _read("/proc/self/status"), re.MULTILINE)
    capabilities = int(found[1], 16) if found else 0
    is_capable = bool(capabilities >> _CAP_SYS_NICE & 1)
    scheduling = scheduling or (REAL_TIME if limit or is_capable else ORDINARY)
    value = f"{scheduling}; rtprio {limit}, CAP_SYS_NICE {'yes' if is_capable else 'no'}"
    if scheduling == REAL_TIME:
        return Setting("scheduling", value)
    gain = "images in time beside busy programs, where the chain breaks down without (docs/containers.md)"
    return Setting("scheduling", value, way_to_real_time(), gain)


def _clock() -> Setting:
    source = _read("/sys/devices/system/clocksource/clocksource0/current_clocksource")
    if source not in SLOW_CLOCKS:
        return Setting("clock source", source or "unknown")
    mend = "add clocksource=tsc tsc=reliable (x86) to the kernel's command line"
    return Setting("clock source", source, mend, "a reading of the clock in tens of ns, see clock_reading_ns")


def _synchronised() -> Setting:
    answer = ctypes.create_string_buffer(_TIMEX_BYTES)
    state = ctypes.CDLL(None).adjtimex(answer)
    if state < 0:
        return Setting("wall clock", "unknown")
    if state != _TIME_ERROR:
        return Setting("wall clock", f"synchronised, error at most {_TIMEX.unpack_from(answer)[3] / 1e3:g} ms")
    return Setting(
        "wall clock",
        "not synchronised",
        "sudo apt install chrony, or ptp4l and phc2sys (linuxptp) where the network has PTP",
        "times of recordings and of TIME (100h) that compare with other hosts; images do not change",
    )


def _timer() -> Setting:
    resolution_s = time.clock_getres(time.CLOCK_MONOTONIC)
    if resolution_s <= _FINE_S:
        return Setting("timer", f"{1e9 * resolution_s:g} ns")
    mend = "boot a kernel with CONFIG_HIGH_RES_TIMERS, and without highres=off"
    return Setting("timer", f"{1e3 * resolution_s:g} ms", mend, "waits that end when due, and not at the next tick")


def _governor() -> Setting:
    files = Path("/sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
    governors = sorted({_read(str(each)) for each in files})
    if governors in ([], ["performance"]):
        return Setting("governor", "".join(governors) or "none")
    mend = "echo performance | sudo tee /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor"
    return Setting("governor", ", ".join(governors), mend, "no wake-up on a processor that is still slow")


def _preemption() -> Setting:
    words = os.uname().version.split()
    value = next((word for word in words if word.startswith("PREEMPT")), "none told")
    chosen = _read("/sys/kernel/debug/sched/preempt")
    if _read("/sys/kernel/realtime") == "1" or value == "PREEMPT_RT":
        return Setting("preemption", "PREEMPT_RT")
    return Setting(
        "preemption",
        f"{value}, {chosen}" if chosen else value,
        "install a kernel with PREEMPT_RT (Debian: linux-image-rt-amd64, -arm64); else preempt=full at boot",
        "a bound of late_max_us where drivers and other programs are busy; p50 hardly changes",
    )


def _read(path: str) -> str:
    """Return the content of a file of the kernel, "" if there is none or it may not be read."""
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except OSError:
        return ""
