"""What a layout gets whose file names only taxels and buses: samples, sums and buses that make good images.

Averages of samples cost nothing on the bus, and sums in place of fewer sums cost nothing but the bus. So boards sample
at `AVERAGED_HZ` where they can, and send as many sums as the buses carry with `ROOM` to spare. The arithmetic is an
upper bound of the load that `skin plan` computes.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from skin.foreign import CLASSIC_MAX, FD_ONLY_LENGTHS
from skin.ways_of_sending import SUMS_PART

if TYPE_CHECKING:
    from skin.layout_keys import Bus, Layout

#: Most samples of a taxel in a second where boards average.
AVERAGED_HZ: Final = 1000.0
#: Highest load of a bus with room to spare, with the most stuff bits.
ROOM: Final = 0.8
#: Taxels per sum that are tried: the last has better images, and is taken where the buses carry it.
COMPRESSIONS: Final = (SUMS_PART, 2, 1)
#: Most buses of a skin whose layout names none.
BUSES_MAX: Final = 16
#: Payload of a frame of sums, bytes, the SYNC counter first: classic CAN, CAN FD.
_PDO_BYTES: Final = (CLASSIC_MAX, FD_ONLY_LENGTHS[-1])
#: Part of the rate of sums in cycles at which the best scan is as good: measured at 0.52, with 0.9 dB to spare.
AS_GOOD: Final = 0.5
#: Bits of a taxel in the best scan of all that were tried (`docs/bandwidth.md`).
SCAN_BITS: Final = 7
#: Most sums of a frame: 64 objects can be mapped (CiA 301, 7.5.2.38), and the counter is the first.
SUMS_MAX: Final = 63
#: A bus has identifiers of sums for eight kinds of PDO of each node-ID.
_PDO_KINDS, _NODE_IDS = 8, 127
#: A heartbeat of each node in a second.
_BEATS_HZ: Final = 1.0


def averaged_hz(layout: "Layout", most: int | None = None) -> float | None:
    """Return the samples in a second, as many whole samples a cycle as `AVERAGED_HZ` allows, at most `most`.

    None, one sample a SYNC, where there is no time for more, or where sums are made before the converters.
    """
    samples = int(AVERAGED_HZ / layout.sync.rate_hz)
    samples = samples if most is None else min(samples, most)
    has_converters = not layout.taxels.is_analogue and layout.measurement.matrix is None
    can_average = layout.sends.in_cycles and has_converters
    return samples * layout.sync.rate_hz if can_average and samples > 1 else None


def carried_sums(layout: "Layout") -> int:
    """Return the most sums of `COMPRESSIONS` that the buses carry with room to spare, the fewest if they carry none.

    An analogue front end has a converter for each sum: it has the fewest.
    """
    tried = [layout.blocks * max(1, layout.measurement.block_size // each) for each in COMPRESSIONS]
    if layout.taxels.is_analogue:
        return tried[0]
    in_time = [sums for sums in tried if carries(layout, sums, ROOM)]
    # At a rate at which no number of sums comes in time from a stock stack, boards have to answer at once.
    return max(in_time or [sums for sums in tried if worst_load(layout, sums) <= ROOM], default=tried[0])


def carries_enough(layout: "Layout", *, has_sums: bool) -> bool:
    """Tell whether the buses carry the sums of a layout; of boards of neighbours, unless it `has_sums`, all with room.

    A part of the sums of neighbours is not enough.
    """
    if has_sums or layout.measurement.wiring == "scattered":
        return carries(layout, layout.measurement.sums)
    return carries(layout, layout.places, ROOM)


def carries(layout: "Layout", sums: int, room: float = 1.0) -> bool:
    """Tell whether each bus is at most `room` full with this number of sums, and all come before the next SYNC."""
    times = [_bus_time(layout, bus, sums) for bus in layout.bus]
    rate_hz, left_s = layout.sync.rate_hz, layout.sync.period_s - layout.device.jitter_s
    return all(each.load(rate_hz) <= room and each.longest_s <= left_s for each in times)


def worst_load(layout: "Layout", sums: int) -> float:
    """Return the load of the fullest bus with this number of sums and the most stuff bits; inf without identifiers."""
    return max(_bus_time(layout, bus, sums).load(layout.sync.rate_hz) for bus in layout.bus)


def scan_words(layout: "Layout") -> str:
    """Say how often the buses carry all taxels with room to spare, and whether that serves as well as sums; or nothing.

    At `AS_GOOD` of the rate of sums in cycles a scan behind the filter of stepped boards is as good. Stepped
    boards look at their taxels at their own rate.
    """
    if layout.taxels.is_analogue or layout.measurement.matrix is not None:
        return ""
    bits = min(SCAN_BITS, layout.taxels.adc_bits)
    room = max(ROOM, worst_load(layout, layout.measurement.sums)) if layout.sends.in_cycles else ROOM
    times = [_bus_time(layout, bus, layout.places, bits) for bus in layout.bus]
    rate_hz = min((room - each.others) / each.cycle_s for each in times) / layout.sync.turns
    of_sums_hz = 1 / layout.sync.round_s if layout.sends.in_cycles else layout.sends.default_rates_hz["sampling"]
    is_as_good = rate_hz >= of_sums_hz * (AS_GOOD if layout.sends.in_cycles else 1)
    good = " and is as good: sums gain nothing here" if is_as_good else f", sums at {of_sums_hz:g} Hz"
    return f"a scan of all taxels of {bits} bits, filtered on the boards, fits these buses at {rate_hz:.1f} Hz{good}"


class _BusTime(NamedTuple):
    """Time of a cycle on a bus, seconds; part of the bus that others take; time that others may take before a cycle."""

    cycle_s: float
    others: float
    blocked_s: float

    def load(self, rate_hz: float) -> float:
        return self.cycle_s * rate_hz + self.others

    @property
    def longest_s(self) -> float:
        return (self.cycle_s + self.blocked_s) / max(1 - self.others, 1e-9)


def _bus_time(layout: "Layout", bus: "Bus", sums: int, bits: int | None = None) -> _BusTime:
    """Return the time of a bus with a number of sums of the skin; inf where it lacks identifiers."""
    bits = bits or layout.encoding.sum_bits
    of_node = -(-sums * bus.blocks_per_node // layout.blocks)
    turns = layout.sync.turns
    most = min(8 * (_PDO_BYTES[bus.fd] - 1) // bits, SUMS_MAX)
    frames = turns * -(-of_node // (turns * most))
    most = -(-of_node // frames) if turns > 1 else most
    # The last frame has what is left; in turns all frames are alike.
    of_frames = [min(most, of_node - most * each) for each in range(frames)]
    times_s = [_frame_s(bus, 1 + (of_frame * bits + 7) // 8, is_fd=bus.fd) for of_frame in of_frames if of_frame > 0]
    known = [(each, each.period_s) for each in bus.foreign if each.period_s]
    foreign = [(_frame_s(bus, each.length, is_fd=each.fd, is_extended=each.is_extended), s) for each, s in known]
    cycle_s = _frame_s(bus, 1) + bus.nodes * sum(times_s) / turns
    if bus.nodes * frames > _PDO_KINDS * (_NODE_IDS - len(bus.foreign)):
        cycle_s = math.inf
    others = bus.nodes * _frame_s(bus, 1) * _BEATS_HZ + sum(time_s / period_s for time_s, period_s in foreign)
    # The longest frame may be on its way, and each message of other devices may have just become due.
    blocked_s = max(*times_s, _frame_s(bus, CLASSIC_MAX)) + sum(time_s for time_s, _ in foreign)
    return _BusTime(cycle_s, others, blocked_s)


def _frame_s(bus: "Bus", length: int, *, is_fd: bool = False, is_extended: bool = False) -> float:
    """Return the longest time of a frame; see `dbc.frame_bits`, whose bits these are, or a few more."""
    head = 54 if is_extended else 34
    if not is_fd:
        return (head + 13 + 8 * length + (head + 8 * length - 1) // 4) / bus.bitrate
    length = next((each for each in FD_ONLY_LENGTHS if each >= length), length) if length > CLASSIC_MAX else length
    nominal = (48 if is_extended else 29) + head // 6
    data = 6 + 8 * length + (27 if length <= 16 else 32) + (8 * length + 9) // 4
    return nominal / bus.bitrate + data / (bus.data_bitrate or bus.bitrate)


def chosen(layout: "Layout", given: Mapping[str, Any]) -> list[str]:
    """Say what was chosen for the keys that a file leaves out, and why; `given` is what the file says."""
    if not layout.sends.in_cycles or layout.measurement.matrix is not None:
        return []
    found = []
    if "bus" not in given:
        found.append(f"bus: {len(layout.bus)} of classic CAN, the fewest that carry the sums")
    if "rate_hz" not in given.get("sampling", {}):
        samples = layout.samples_per_sync
        why = "averaged for less noise" if samples > 1 else "there is no time for more, or boards cannot average"
        found.append(f"sampling.rate_hz = {samples * layout.sync.rate_hz:g}: {samples} in a cycle, {why}")
    measurement = given.get("measurement", {})
    if "sums" not in measurement and layout.measurement.rows is None:
        sums = layout.measurement.sums
        load = worst_load(layout, 2 * sums)
        late = "lack identifiers" if load == math.inf else f"take {load:.0%}" if load > ROOM else "come late"
        more = "" if sums == layout.places else f"; {2 * sums} would {late}"
        full = f"buses up to {worst_load(layout, sums):.0%} full{more}"
        if layout.taxels.is_analogue:
            full = "each needs a converter"
        of = layout.places // sums
        each = f"{of} taxels" if of > 1 else "each taxel, nothing is compressed"
        found.append(f"measurement.sums = {sums}, one for {each}: {full}")
    return found
