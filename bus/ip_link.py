"""The command that sets up a SocketCAN interface for a bus of a layout (iproute2, ip-link(8))."""

from typing import Final

from skin.layout import Bus

#: Frames that wait in the interface. The kernel's default of 10 is less than virtual nodes send at a SYNC.
TRANSMIT_QUEUE_FRAMES: Final = 1000
#: Time from bus-off to the controller's restart; the kernel's default is never.
RESTART_MS: Final = 100


def sample_point(bit_rate_hz: int) -> float:
    """Return the sample point that CiA recommends for a bit rate, as Linux chooses by default.

    Source: CiA 102, and ``can_calc_bittiming`` of the kernel.
    """
    return 0.75 if bit_rate_hz > 800_000 else 0.8 if bit_rate_hz > 500_000 else 0.875


def data_bit_rate_hz(bus: Bus) -> int | None:
    """Return the bit rate of the data phase; the nominal rate of CAN FD without an own one, None for classic CAN."""
    return (bus.data_bitrate or bus.bitrate) if bus.fd else None


def ip_link(channel: str, bus: Bus) -> str:
    """Return the command line that gives `channel` the bit rates of `bus` and sets it up; the interface must be down.

    The kernel computes the bit timing for the controller's clock, and transmitter delay compensation if the driver
    knows it.
    """
    words = f"{timing_options(bus.bitrate, data_bit_rate_hz(bus))} restart-ms {RESTART_MS}"
    return f"ip link set {channel} up txqueuelen {TRANSMIT_QUEUE_FRAMES} type can {words}"


def timing_options(bit_rate_hz: int, data_bit_rate_hz: int | None) -> str:
    """Return the options for the bit rates, the second that of CAN FD; they follow ``type can``."""
    words = f"bitrate {bit_rate_hz} sample-point {sample_point(bit_rate_hz):.3f}"
    if data_bit_rate_hz:
        words += f" dbitrate {data_bit_rate_hz} dsample-point {sample_point(data_bit_rate_hz):.3f} fd on"
    return words
