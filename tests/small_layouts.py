"""Texts of small layouts that tests of several folders use."""

from typing import Final

#: Two adaptive boards on one bus of classic CAN, called "arm".
ADAPTIVE_ARM: Final = """
sending = "adaptive"
taxels = { rows = 8, columns = 8 }
measurement = { wiring = "board" }
sync = { rate_hz = 10.0 }
bus = [{ name = "arm", nodes = 2 }]
"""
