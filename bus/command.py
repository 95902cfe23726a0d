"""``skin bus``: the arbitrated virtual buses."""

from pathlib import Path
from typing import Final

from bus.faults import parse_fault
from bus.options import check_bit_rates, virtual_bit_rates
from bus.server import BusServer, BusSettings
from canskin.errors import InputError
from shell.pulse import Pulse
from shell.service import StopSignal, request_real_time, say
from shell.terminal import Json, print_json
from skin.layout import load_layout
from skin.ranges import listed

#: Far above any real device, and far below the limit of times in 64 bits.
RESTART_MAX_S: Final = 3600.0
#: Without a layout, in bit/s: buses that carry CAN FD, too.
DEFAULT_BIT_RATES: Final = (1_000_000, 5_000_000)


def bus(
    channels: list[str] | None = None,
    *,
    layout: Path | None = None,
    bitrate: int | None = None,
    data_bitrate: int | None = None,
    fault: list[str] | None = None,
    seed: int = 0,
    restart_s: float = 0.1,
    queue_size: int = 256,
    json_: Json = False,
) -> None:
    """Serve virtual CAN buses with exact bit times, arbitration, error states and, if wanted, faults.

    Programs open the buses as interface ``canskin`` of python-can, other verbs with ``--interface canskin``.
    Runs until Ctrl-C.

    Parameters
    ----------
    channels
        Names of the buses. Default: those of the layout.
    layout
        The layout of the skin. Default: the default skin's.
    bitrate
        Bits per second, 10000 to 1000000. Default: that of the layout, else 1000000.
    data_bitrate
        Bits per second in the data phase of CAN FD frames, up to 8000000; 0 for buses without CAN FD.
        Default: that of the layout, else 5000000.
    fault
        A fault, ``KEY=VALUE,…`` with the keys controller, can_id, mask, loss_ratio,
        duplicate_ratio, delay_ratio, delay_s, bit_error_rate, off. Repeat the option for more faults.
    seed
        Seed of the faults: the same seed and the same frames give the same faults.
    restart_s
        Seconds that a bus-off controller waits before its recovery begins.
    queue_size
        Number of frames in the transmit queue of each controller.
    json_
        Print the counters of every bus as one JSON object at the end.

    Examples
    --------
    skin bus
    skin bus --layout palm.toml
    skin bus bus0 --bitrate 500000 --fault can_id=0x700,mask=0x780,loss_ratio=0.01
    """
    contract = load_layout(layout)
    rates = DEFAULT_BIT_RATES if layout is None else virtual_bit_rates(contract)
    bitrate = rates[0] if bitrate is None else bitrate
    data_bitrate = rates[1] if data_bitrate is None else data_bitrate
    check_bit_rates(bitrate, data_bitrate)
    if queue_size < 1 or not 0 <= restart_s <= RESTART_MAX_S:
        wanted = f"a queue of 1 or more frames and a restart after 0 to {RESTART_MAX_S:g} s"
        raise InputError(f"expected {wanted}, got {queue_size} and {restart_s}")
    names = listed(channels or ()) or [each.name for each in contract.bus]
    settings = BusSettings(
        bitrate=bitrate,
        data_bitrate=data_bitrate or None,
        faults=[parse_fault(text) for text in fault or []],
        seed=seed,
        restart_s=restart_s,
        queue_size=queue_size,
    )
    stop = StopSignal().install()
    with BusServer(names, settings) as server:
        request_real_time("bus")
        say("bus", f"ready: {', '.join(names)} at {bitrate} bit/s")
        server.serve(Pulse(stop).is_set)
        if json_:
            print_json({name: one.counts for name, one in server.buses.items()})
