"""Frames and the greeting."""

import struct
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from health.state import ViewState
from skin.layout import load_layout
from views.page.wire import frame, greeting


def test_frame_can_be_taken_apart(messages: Any) -> None:
    state = ViewState(messages.layout)
    state.take(messages.image(4, invalid=(2,)), 1.0)
    state.take(messages.truth(4, sensor=messages.grid(0.02)), 1.0)
    content = frame(*state.snapshot(1.1))
    (length,) = struct.unpack_from("<I", content)
    header = msgspec.json.decode(content[4 : 4 + length])
    assert length % 4 == 0
    assert header["pictures"] == ["image", "true", "sensor"]
    assert header["snapshot"]["image"]["invalid_blocks"] == [2]
    pictures = np.frombuffer(content, "<f4", offset=4 + length).reshape(3, 16, 16)
    np.testing.assert_array_equal(pictures[0], messages.grid())
    np.testing.assert_array_equal(pictures[2], messages.grid(0.02))


def test_frame_without_pictures_is_a_header(messages: Any) -> None:
    content = frame(*ViewState(messages.layout).snapshot(0.0))
    (length,) = struct.unpack_from("<I", content)
    assert len(content) == 4 + length
    assert msgspec.json.decode(content[4:])["pictures"] == []


def test_greeting_names_the_block_that_measures_each_taxel(messages: Any) -> None:
    layout = messages.layout
    phi, block_of_taxel = layout.phi(), greeting(layout)["block_of_taxel"]
    for taxel in range(layout.taxels.count):
        alone = np.zeros(layout.taxels.count, np.int32)
        alone[taxel] = 1
        assert set(phi.block_of_sum[phi.forward(alone) != 0]) == {block_of_taxel[taxel]}


def test_greeting_says_how_many_blocks_a_node_has() -> None:
    assert [bus["blocks_per_node"] for bus in greeting(load_layout(Path("fd")))["buses"]] == [4]


def test_greeting_names_the_first_block_of_each_bus(messages: Any) -> None:
    assert [(bus["name"], bus["first_block"], bus["nodes"]) for bus in greeting(messages.layout)["buses"]] == [
        ("left", 0, 4),
        ("right", 4, 4),
    ]


def test_greeting_has_both_bit_rates_of_an_fd_bus(messages: Any) -> None:
    fd = load_layout(Path("fd"))
    assert [(bus["bitrate"], bus["data_bitrate"]) for bus in greeting(fd)["buses"]] == [
        (bus.bitrate, bus.data_bitrate) for bus in fd.bus
    ]
    assert fd.bus[0].data_bitrate is not None
    assert {bus["data_bitrate"] for bus in greeting(messages.layout)["buses"]} == {None}


def test_greeting_has_a_word_for_every_nmt_state(messages: Any) -> None:
    words = {"0": "booting", "4": "stopped", "5": "operational", "127": "pre-operational", "255": "silent"}
    assert greeting(messages.layout)["nmt"] == words
