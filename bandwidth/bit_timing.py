"""Bit timing of CAN controllers: the segments of a bit for a clock and the bit rates of a bus (ISO 11898-1)."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Annotated, Final

from cyclopts import Parameter

from bus.ip_link import data_bit_rate_hz, ip_link
from shell.terminal import print_table
from skin.layout import Bus
from skin.ranges import require_above_zero

#: Usual clocks of CAN controllers: CAN FD with 80 and 40 MHz (CiA 601-3), classic CAN with 8 MHz or multiples.
CLOCKS_HZ: Final = (80_000_000, 40_000_000, 8_000_000)
#: Delay of a twisted pair per metre.
DELAY_NS_PER_M: Final = 5.0
#: Highest data prescaler with transmitter delay compensation (ISO 11898-1, 11.3.3).
TDC_PRESCALER_MAX: Final = 2
_PPM_PER_PERCENT: Final = 10_000


@Parameter(name="*")
@dataclass(frozen=True)
class TimingOptions:
    """Controllers and wires for ``skin plan --timing``; InputError refuses what cannot be.

    Parameters
    ----------
    clock_hz : list of int
        Timing: clocks of the CAN controllers, Hz. Default: 80, 40 and 8 MHz.
    bus_length_m : float
        Timing: length of a bus, metres.
    loop_delay_ns : float
        Timing: time from TXD to RXD of the slowest transceiver, nanoseconds. ISO 11898-2 allows 255.
    """

    clock_hz: Annotated[list[int], Parameter(negative=(), show_default=False)] = field(default_factory=list)
    bus_length_m: float = 10.0
    loop_delay_ns: float = 255.0

    def __post_init__(self) -> None:
        for clock_hz in self.clock_hz:
            require_above_zero("--clock-hz", clock_hz, 1e9)
        require_above_zero("--bus-length-m", self.bus_length_m, 1e4)
        require_above_zero("--loop-delay-ns", self.loop_delay_ns, 1e4)

    @property
    def round_trip_ns(self) -> float:
        """Time of a bit to the far end of the bus and back, through both transceivers."""
        return 2 * (self.loop_delay_ns + DELAY_NS_PER_M * self.bus_length_m)


@dataclass(frozen=True)
class PhaseTiming:
    """The bit in the arbitration or the data phase; segments in time quanta, after the quantum of SYNC_SEG.

    `tseg1` is PROP_SEG and PHASE_SEG1 together; the data phase needs no PROP_SEG. `sjw` is not longer than PHASE_SEG1
    and `tseg2` (ISO 11898-1). `rate_error_ppm` is the error of the bit rate with an exact clock.
    """

    phase: str
    bit_rate_hz: int
    prescaler: int
    prop_seg: int
    phase_seg1: int
    tseg1: int
    tseg2: int
    sjw: int
    sample_point: float
    rate_error_ppm: float


@dataclass(frozen=True)
class ControllerTiming:
    """The bit timing of a controller with a clock of `clock_hz`; `problem` says why there is none, or none that works.

    `oscillator_tolerance_ppm` is what the clock of each node may be off. `tdc_offset_clocks` is the offset of
    transmitter delay compensation in periods of the clock: the sample point of the data phase. None without data phase
    or with a data prescaler above `TDC_PRESCALER_MAX`. `needs_tdc` tells whether the data phase samples a bit before
    the transmitter has received it from its own transceiver.
    """

    clock_hz: int
    phases: list[PhaseTiming]
    oscillator_tolerance_ppm: float
    tdc_offset_clocks: int | None
    needs_tdc: bool
    problem: str


def controller_timing(bus: Bus, clock_hz: int, options: TimingOptions) -> ControllerTiming:
    """Compute the bit timing of a bus for a controller's clock, see `choose_timing`."""
    from bus.bit_timing import choose_timing, segments

    data_hz = data_bit_rate_hz(bus)
    rates_hz = [bus.bitrate] if data_hz is None else [bus.bitrate, data_hz]
    best = choose_timing(clock_hz, rates_hz)
    if best is None:
        rates = " and ".join(f"{rate_hz / 1e3:g} kbit/s" for rate_hz in rates_hz)
        return ControllerTiming(clock_hz, [], 0.0, None, False, f"this clock cannot make {rates}")
    phases: list[PhaseTiming] = []
    for rate_hz, name, each in zip(rates_hz, ("nominal", "data"), segments(best), strict=False):
        prop_seg = 0 if phases else math.ceil(round(1e-9 * options.round_trip_ns * clock_hz / each.prescaler, 6))
        phase_seg1 = each.tseg1 - prop_seg
        phases.append(
            PhaseTiming(
                phase=name,
                bit_rate_hz=rate_hz,
                prescaler=each.prescaler,
                prop_seg=prop_seg,
                phase_seg1=phase_seg1,
                tseg1=each.tseg1,
                tseg2=each.tseg2,
                sjw=min(each.sjw, max(phase_seg1, 1), each.tseg2),
                sample_point=each.sample_point,
                rate_error_ppm=each.rate_error_ppm(clock_hz, rate_hz),
            )
        )
    tolerance_ppm = _PPM_PER_PERCENT * best.oscillator_tolerance(options.loop_delay_ns, options.bus_length_m)
    last = phases[-1]
    sample_clocks = (1 + last.tseg1) * last.prescaler
    has_tdc = data_hz is not None and last.prescaler <= TDC_PRESCALER_MAX
    needs_tdc = data_hz is not None and 1e9 * sample_clocks / clock_hz < options.loop_delay_ns
    problem = ""
    if phases[0].phase_seg1 < 1:
        problem = (
            f"{options.round_trip_ns:.0f} ns through two transceivers and {options.bus_length_m:g} m there and back "
            "leave no time before the sample point: expected a shorter bus, faster transceivers or a lower bit rate"
        )
    elif (error_ppm := max(abs(each.rate_error_ppm) for each in phases)) >= tolerance_ppm:
        problem = f"the bit rate is off by {error_ppm:.0f} ppm, and the clocks may be off by {tolerance_ppm:.0f} ppm"
    elif needs_tdc and not has_tdc:
        problem = f"the data phase needs transmitter delay compensation, which has prescalers up to {TDC_PRESCALER_MAX}"
    return ControllerTiming(
        clock_hz, phases, tolerance_ppm, sample_clocks if has_tdc else None, needs_tdc and has_tdc, problem
    )


@dataclass(frozen=True)
class BusTiming:
    """Bit timing of a bus with each clock, and the command that sets up its interface."""

    bus: str
    ip_link: str
    controllers: list[ControllerTiming]


def bus_timings(buses: Iterable[Bus], channels: Iterable[str], options: TimingOptions) -> list[BusTiming]:
    """Compute the bit timing of each bus for all clocks."""
    clocks_hz = options.clock_hz or CLOCKS_HZ
    return [
        BusTiming(bus.name, ip_link(name, bus), [controller_timing(bus, each, options) for each in clocks_hz])
        for bus, name in zip(buses, channels, strict=True)
    ]


def print_timings(timings: list[BusTiming]) -> None:
    """Print a table for buses of equal timing, problems, and the commands of all interfaces."""
    alike: dict[str, tuple[list[str], list[ControllerTiming]]] = {}
    for each in timings:
        alike.setdefault(repr(each.controllers), ([], each.controllers))[0].append(each.bus)
    for names, controllers in alike.values():
        rows = [
            [
                f"{timing.clock_hz / 1e6:g}",
                phase.phase,
                f"{phase.bit_rate_hz / 1e3:g}",
                phase.prescaler,
                f"{phase.tseg1} ({phase.prop_seg} + {phase.phase_seg1})" if phase.phase_seg1 > 0 else phase.tseg1,
                phase.tseg2,
                phase.sjw,
                f"{phase.sample_point:.1%}",
                f"{phase.rate_error_ppm:.0f}",
                f"{timing.oscillator_tolerance_ppm:.0f}",
                timing.tdc_offset_clocks if phase.phase == "data" else None,
            ]
            for timing in controllers
            for phase in timing.phases
        ]
        headings = "clock, MHz|phase|kbit/s|prescaler|tseg1 (prop + phase1)|tseg2|sjw|sample point|rate error, ppm"
        title = f"bit timing of {', '.join(names)}"
        print_table([*headings.split("|"), "clock tolerance, ppm", "TDC offset, clocks"], rows, title=title)
        for timing in controllers:
            if timing.problem:
                print(f"{timing.clock_hz / 1e6:g} MHz: {timing.problem}")
            elif timing.needs_tdc:
                print(f"{timing.clock_hz / 1e6:g} MHz: switch on transmitter delay compensation (TDC)")
        print()
    print("\n".join(each.ip_link for each in timings))
