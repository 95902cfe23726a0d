"""Command lines that set up interfaces, with iproute2 as the judge of their words."""

import shutil
import subprocess

import pytest

from bus.ip_link import ip_link
from skin.layout import Bus

CLASSIC = Bus(name="bus0", nodes=1, bitrate=500_000)
FD = Bus(name="bus0", nodes=1, bitrate=1_000_000, fd=True, data_bitrate=5_000_000)
FD_OF_ONE_RATE = Bus(name="bus0", nodes=1, bitrate=500_000, fd=True)


def test_rates_of_the_bus_and_sample_points_of_cia_are_set() -> None:
    assert "bitrate 500000 sample-point 0.875 restart-ms" in ip_link("can0", CLASSIC)
    assert "bitrate 1000000 sample-point 0.750 dbitrate 5000000 dsample-point 0.750 fd on" in ip_link("can0", FD)
    # Linux refuses CAN FD without a data bit rate.
    assert "bitrate 500000 sample-point 0.875 dbitrate 500000 dsample-point" in ip_link("can0", FD_OF_ONE_RATE)


@pytest.mark.parametrize("bus", [CLASSIC, FD, FD_OF_ONE_RATE])
def test_iproute2_knows_every_word(bus: Bus) -> None:
    if not shutil.which("ip"):
        pytest.skip("NOT TESTED: no iproute2")
    # iproute2 reads all words of "add" before the kernel refuses to make a controller.
    words = ip_link("none9", bus).replace(" set ", " add ").split()
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert "option" not in done.stderr
    done = subprocess.run([*words, "nonsense", "1"], capture_output=True, text=True, check=False)
    assert 'unknown option "nonsense"' in done.stderr
