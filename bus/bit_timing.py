"""The choice of a bit timing: prescaler and segments of a bit for a controller's clock (ISO 11898-1)."""

from collections.abc import Mapping
from typing import NamedTuple

from can import BitTiming, BitTimingFd

from bus.ip_link import sample_point


class Segments(NamedTuple):
    """A bit in one phase; segments in time quanta, `tseg1` is PROP_SEG and PHASE_SEG1 together."""

    prescaler: int
    tseg1: int
    tseg2: int
    sjw: int

    @property
    def sample_point(self) -> float:
        """Place of the sample point in the bit, 0 to 1."""
        return (1 + self.tseg1) / (1 + self.tseg1 + self.tseg2)

    def rate_error_ppm(self, clock_hz: int, bit_rate_hz: int) -> float:
        """Return the error of the bit rate with an exact clock."""
        return 1e6 * (clock_hz / (self.prescaler * (1 + self.tseg1 + self.tseg2)) / bit_rate_hz - 1)


def segments(timing: Mapping[str, int]) -> list[Segments]:
    """Return the arbitration phase of a `can.BitTiming`; both phases of a `can.BitTimingFd`."""
    prefixes = ("nom_", "data_") if "nom_brp" in timing else ("",)
    return [Segments(*(timing[f"{prefix}{key}"] for key in ("brp", "tseg1", "tseg2", "sjw"))) for prefix in prefixes]


def choose_timing(clock_hz: int, rates_hz: list[int]) -> BitTiming | BitTimingFd | None:
    """Choose the bit timing for one bit rate, or for those of the arbitration and the data phase of CAN FD.

    Of all timings within the ranges that ISO 11898-1 asks of every controller, the timing with the smallest error of
    the bit rates is chosen, then the timing nearest to the recommended sample points, then the timing whose prescalers
    differ least, then the shortest quanta. None if the clock cannot make the rates.
    """
    wanted = [value for rate_hz in rates_hz for value in (rate_hz, 100 * sample_point(rate_hz))]
    kind = BitTiming if len(rates_hz) == 1 else BitTimingFd
    found = kind.iterate_from_sample_point(clock_hz, *wanted)  # type: ignore[arg-type]
    return min(found, key=lambda timing: _badness(clock_hz, rates_hz, segments(timing)), default=None)


def _badness(clock_hz: int, rates_hz: list[int], phases: list[Segments]) -> tuple[float, float, int, int]:
    prescalers = [each.prescaler for each in phases]
    pairs = list(zip(phases, rates_hz, strict=True))
    return (
        sum(abs(each.rate_error_ppm(clock_hz, rate_hz)) for each, rate_hz in pairs),
        sum(round(abs(each.sample_point - sample_point(rate_hz)), 6) for each, rate_hz in pairs),
        max(prescalers) - min(prescalers),
        sum(prescalers),
    )
