"""Bit timing: published registers, a slow search as judge, and clocks that cannot make a rate."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bandwidth.bit_timing import TimingOptions, controller_timing
from canskin.errors import InputError
from skin.layout import Bus
from tests.processes import Verb

SHORT = TimingOptions(bus_length_m=1.0, loop_delay_ns=100.0)


def bus(bit_rate_hz: int, data_hz: int | None = None) -> Bus:
    return Bus(name="bus0", nodes=1, bitrate=bit_rate_hz, fd=data_hz is not None, data_bitrate=data_hz)


@pytest.mark.parametrize(
    ("bit_rate_hz", "quanta", "sample_quanta"),
    [(1_000_000, 8, 6), (800_000, 10, 8), (500_000, 16, 14), (250_000, 16, 14), (125_000, 16, 14)],
)
def test_a_clock_of_8_or_16_mhz_gives_the_bits_of_cia_102(bit_rate_hz: int, quanta: int, sample_quanta: int) -> None:
    for clock_hz in (8_000_000, 16_000_000):
        timing = controller_timing(bus(bit_rate_hz), clock_hz, SHORT)
        (phase,) = timing.phases
        assert phase.sample_point == pytest.approx(sample_quanta / quanta)
        assert (1 + phase.tseg1 + phase.tseg2) % quanta == 0 or phase.prescaler * quanta <= clock_hz / bit_rate_hz
        assert phase.rate_error_ppm == 0
        assert timing.problem == ""


def test_can_fd_with_80_mhz_is_what_linux_computes() -> None:
    """As ``ip -details link show`` prints for a controller of 80 MHz: 12 ns, 29 + 30 and 20; 12 ns, 5 + 6 and 4."""
    nominal, data = (timing := controller_timing(bus(1_000_000, 5_000_000), 80_000_000, SHORT)).phases
    assert (nominal.prescaler, nominal.tseg1, nominal.tseg2) == (1, 29 + 30, 20)
    assert (data.prescaler, data.tseg1, data.tseg2) == (1, 5 + 6, 4)
    assert timing.tdc_offset_clocks == 1 + 5 + 6


def test_compensation_is_needed_where_the_loop_is_longer_than_the_time_to_the_sample_point() -> None:
    """At 5 Mbit/s the sample point of 75 % comes 150 ns after the begin of a bit."""
    fast = bus(1_000_000, 5_000_000)
    assert controller_timing(fast, 40_000_000, TimingOptions(loop_delay_ns=151)).needs_tdc
    assert not controller_timing(fast, 40_000_000, TimingOptions(loop_delay_ns=149)).needs_tdc
    assert not controller_timing(bus(1_000_000, 1_000_000), 40_000_000, TimingOptions(loop_delay_ns=255)).needs_tdc


def test_a_bus_is_refused_that_is_longer_than_the_time_before_the_sample_point() -> None:
    """750 ns at 1 Mbit/s: one quantum each for SYNC_SEG and PHASE_SEG1, two loops, and the bus of 5 ns/m twice."""
    for length_m, fits in ((10.0, True), (40.0, False)):
        timing = controller_timing(bus(1_000_000), 40_000_000, TimingOptions(bus_length_m=length_m))
        assert (timing.problem == "") is fits
        assert (timing.oscillator_tolerance_ppm > 0) is fits


def test_tolerance_of_clocks_is_that_of_iso_11898() -> None:
    """SJW / (20 bits) and min(phases) / (2 (13 bits - PHASE_SEG2)), in quanta."""
    timing = controller_timing(bus(500_000), 8_000_000, SHORT)
    (phase,) = timing.phases
    quanta = 1 + phase.tseg1 + phase.tseg2
    expected = min(phase.sjw / (20 * quanta), min(phase.phase_seg1, phase.tseg2) / (2 * (13 * quanta - phase.tseg2)))
    assert timing.oscillator_tolerance_ppm == pytest.approx(1e6 * expected)


@given(prescaler=st.integers(1, 32), quanta=st.integers(8, 16), bit_rate_hz=st.integers(10_000, 1_000_000))
def test_a_clock_that_can_make_a_rate_exactly_does(prescaler: int, quanta: int, bit_rate_hz: int) -> None:
    """Every controller has prescalers of 1 to 32, and at least 16 quanta before the sample point."""
    clock_hz = prescaler * quanta * bit_rate_hz
    (phase,) = controller_timing(bus(bit_rate_hz), clock_hz, SHORT).phases
    assert phase.prescaler * (1 + phase.tseg1 + phase.tseg2) == prescaler * quanta
    assert phase.rate_error_ppm == pytest.approx(0, abs=1e-6)
    assert 1 <= phase.sjw <= min(max(phase.phase_seg1, 1), phase.tseg2)
    assert phase.prop_seg + phase.phase_seg1 == phase.tseg1


@pytest.mark.parametrize(("round_trip_ns", "quanta"), [(500, 4), (501, 5), (499, 4), (1000, 8), (1125, 9)])
def test_the_propagation_segment_is_the_round_trip_in_whole_quanta(round_trip_ns: int, quanta: int) -> None:
    """A quantum of 125 ns, 16 in a bit; a bus of 10 m there and back takes 100 ns."""
    options = TimingOptions(loop_delay_ns=round_trip_ns / 2 - 50)
    (phase,) = controller_timing(bus(500_000), 8_000_000, options).phases
    assert phase.prop_seg == quanta


def test_a_rate_that_is_off_by_more_than_the_clocks_may_be_is_refused() -> None:
    """8.03 MHz make 501.875 kbit/s; 8.1 MHz are off by more than any CAN controller bears."""
    (phase,) = (timing := controller_timing(bus(500_000), 8_030_000, SHORT)).phases
    assert phase.rate_error_ppm == pytest.approx(3750)
    assert timing.oscillator_tolerance_ppm > 3750
    assert timing.problem == ""
    long = TimingOptions(bus_length_m=120.0, loop_delay_ns=100.0)
    assert "off by 3750 ppm" in controller_timing(bus(500_000), 8_030_000, long).problem
    assert "cannot make 500 kbit/s" in controller_timing(bus(500_000), 8_100_000, SHORT).problem


def test_a_clock_that_the_user_names_must_make_the_rates(skin: Verb) -> None:
    assert skin("plan", "fd", "--timing")[0] == 0
    status, out, _ = skin("plan", "fd", "--timing", "--clock-hz", "40000000", "8000000")
    assert status == 1
    assert "8 MHz: this clock cannot make 1000 kbit/s and 5000 kbit/s" in out
    assert "ip link set can0 up" in out


def test_json_timing_has_every_bus_and_its_interface(skin: Verb) -> None:
    status, out, _ = skin("plan", "steps-fd", "--timing", "-c", "can4", "--json")
    found = json.loads(out)
    assert status == 0
    assert [each["bus"] for each in found] == ["bus0", "bus1"]
    assert "link set can5 " in found[1]["ip_link"]
    assert found[0]["controllers"][0]["phases"][1]["bit_rate_hz"] == 5_000_000


@pytest.mark.parametrize("wrong", [{"clock_hz": [0]}, {"bus_length_m": float("nan")}, {"loop_delay_ns": -1.0}])
def test_controllers_that_cannot_be_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match="needs a number above 0, up to"):
        TimingOptions(**wrong)
