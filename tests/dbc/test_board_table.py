"""Every value of a board's table, each computed here from the layout and from CiA 301."""

import msgspec
import pytest

from dbc.board import Board, BoardPart, MappedObject, board, board_text, json_text
from dbc.contract import Contract
from skin.layout import Layout, changed
from tests.layouts import STEPPED, buses, small_layout

#: Two sums from the second block of the second board: rows 1 and 31, an odd number of bits each.
FEW = small_layout(
    8,
    16,
    name="palm",
    taxels={"force_max_n": 0.1023},
    measurement={"seed": 3, "rows": [[0, 0], [2, 1], [2, 31]]},
    sync={"rate_hz": 50.0},
    sampling={"rate_hz": 200.0},
    encoding={"sum_bits": 12, "offset_binary": True},
    device={"vendor_id": 42, "product_code": 7, "first_serial": 100},
    bus=[
        {"name": "left", "nodes": 1, "bitrate": 500_000},
        {"name": "right", "nodes": 1, "blocks_per_node": 2, "bitrate": 250_000},
        {"name": "end", "nodes": 1, "bitrate": 500_000},
    ],
)
FAST = small_layout(
    sync={"rate_hz": 25.0, "turns": 2},
    encoding={"sum_bits": 15},
    bus=buses(1, names=["arm"], blocks_per_node=2, fd=True, data_bitrate=2_000_000),
)
ANALOGUE = small_layout(taxels={"frontend": "analogue"})


def table_of(layout: Layout, place: int = -1) -> tuple[Contract, Board]:
    contract = Contract.from_layout(layout)
    return contract, board(contract, contract.nodes[place])


def test_a_table_names_every_constant_of_the_board() -> None:
    """1006h is 20 ms, 1007h 99 % of it; 2005h: 12 bits, steps of 2^4, form 1 (offset binary), two blocks."""
    contract, table = table_of(FEW, 1)
    told = msgspec.to_builtins(table)
    assert len(told.pop("phi_fingerprint")) == 16
    assert isinstance(told.pop("signature"), int)
    assert told == {
        "skin": "palm",
        "bus": "right",
        "node_id": 1,
        "bitrate": 250_000,
        "is_fd": False,
        "vendor_id": 42,
        "product_code": 7,
        "revision": 0x0002_0001,
        "serial": 101,
        "sync_cob_id": 0x80,
        "sync_period_us": 20_000,
        "sync_window_us": 19_800,
        "sync_overflow": 240,
        "emcy_cob_id": 0x81,
        "sdo_request_cob_id": 0x601,
        "sdo_response_cob_id": 0x581,
        "heartbeat_cob_id": 0x701,
        "heartbeat_ms": 1000,
        "sending": "synchronous",
        "adc_bits": 10,
        "count_max": 1023,
        "newton_per_count": pytest.approx(1e-4),
        "samples_per_sync": 4,
        "encoding": 0x02_01_04_0C,
        "packing": {"bits": 12, "step_counts": 16, "zero": 0x555, "raw_min": 0, "raw_max": 4095},
        "phi_seed": 3,
        "tpdos": [
            {
                "number": 1,
                "cob_id": 0x181,
                "transmission_type": 1,
                "sync_start_value": 0,
                "inhibit_100us": 0,
                "event_timer_ms": 0,
                "length": 4,
                "mapping": [
                    {"index": 0x2022, "subindex": 0, "bits": 8},
                    {"index": 0x2300, "subindex": 1, "bits": 12},
                    {"index": 0x2300, "subindex": 2, "bits": 12},
                ],
            }
        ],
        "blocks": [
            {
                "block": 1,
                "first_sum": 0,
                "taxels": contract.phi.order[32:64].tolist(),
                "rows": [],
                "signs": [],
                "gain": [1.0] * 32,
                "offset_counts": [0] * 32,
            },
            {
                "block": 2,
                "first_sum": 0,
                "taxels": contract.phi.order[64:96].tolist(),
                "rows": [1, 31],
                "signs": ["+-" * 16, "+--+-++--++-+--+-++-+--++--+-++-"],
                "gain": [1.0] * 32,
                "offset_counts": [0] * 32,
            },
        ],
    }


def test_boards_that_send_in_turns_have_a_start_value_for_each() -> None:
    """Type 2: every second SYNC, counted from 1 and from 2 on. A byte and eight sums of 15 bits: 16 bytes."""
    _, table = table_of(FAST)
    assert (table.is_fd, table.data_bitrate, table.bitrate) == (True, 2_000_000, 1_000_000)
    assert (table.sync_overflow, table.sync_window_us) == (240, 39_600)
    assert [(each.first_sum, len(each.rows)) for each in table.blocks] == [(0, 8), (8, 8)]
    for number, (tpdo, cob_id) in enumerate(zip(table.tpdos, (0x181, 0x281), strict=True), 1):
        assert (tpdo.number, tpdo.cob_id, tpdo.length) == (number, cob_id, 16)
        assert (tpdo.transmission_type, tpdo.sync_start_value) == (2, number)
        counter, sums = MappedObject(index=0x2022, subindex=0, bits=8), range(1, 9)
        index = (0x2100, 0x2300)[number - 1]
        assert tpdo.mapping == [counter, *(MappedObject(index=index, subindex=place, bits=15) for place in sums)]


def test_a_board_with_one_sum_has_one_tpdo_however_many_turns_there_are() -> None:
    few = changed(FEW, measurement={"rows": [[2, 1]]}, sync={"turns": 2})
    _, table = table_of(few, 1)
    assert [(each.transmission_type, each.sync_start_value, len(each.mapping)) for each in table.tpdos] == [(2, 1, 2)]
    assert table_of(few)[1].tpdos == []  # nor any of a board without sums


def test_stepped_boards_have_words_a_unit_and_no_packing() -> None:
    """32 sums of 32 taxels of 20 mN, in two places of a slot of 4 ms."""
    _, table = table_of(small_layout(**STEPPED), 1)
    assert (table.sending, table.packing, table.frontend, table.samples_per_sync) == ("steps", None, None, 100)
    (tpdo,) = table.tpdos
    assert (tpdo.number, tpdo.cob_id, tpdo.transmission_type, tpdo.length) == (1, 0x182, 254, 8)
    assert (tpdo.inhibit_100us, tpdo.event_timer_ms, tpdo.sync_start_value) == (0, 0, 0)
    assert [(each.index, each.subindex, each.bits) for each in tpdo.mapping] == [(0x2022, 0, 8), (0x2110, 1, 56)]
    assert (table.unit_n, table.quiet, table.slots_per_sync, table.slot_offset_us) == (0.64 / 8192, 0.1, 25, 2000)
    assert table.parts == [BoardPart(sums=32, radix=3, has_first=True)]
    assert table.rows_of_parts is not None
    assert table.rows_of_parts[:12] == [0, 4, 6, 2, 16, 20, 22, 18, 3, 7, 5, 1]
    assert sorted(table.rows_of_parts) == list(range(32))


def test_analogue_boards_have_no_calibration_of_taxels() -> None:
    """2005h: 14 bits, steps of 2^5, form 4, one block."""
    _, table = table_of(ANALOGUE)
    assert (table.frontend, table.encoding, table.node_id, table.serial) == ("analogue", 0x01_04_05_0E, 2, 2)
    assert [(each.block, each.gain, each.offset_counts) for each in table.blocks] == [(1, [], [])]
    assert (table.emcy_cob_id, table.sdo_request_cob_id, table.sdo_response_cob_id) == (0x82, 0x602, 0x582)
    assert (table.heartbeat_cob_id, table.unit_n, table.quiet, table.parts) == (0x702, None, None, None)


def test_a_text_has_a_line_for_each_value_and_each_table_of_a_list() -> None:
    value = {
        "number": 1,
        "plain": [1, 2.5],
        "none": [],
        "part": {"a": 1, "b": "two"},
        "tables": [{"x": 1, "y": None}, {"x": 2, "deep": [3]}],
        "lists": [[1, 2], [3]],
    }
    assert json_text(value) == (
        "{\n"
        '  "number": 1,\n'
        '  "plain": [1, 2.5],\n'
        '  "none": [],\n'
        '  "part": {"a": 1, "b": "two"},\n'
        '  "tables": [\n'
        '    {"x": 1, "y": null},\n'
        "    {\n"
        '      "x": 2,\n'
        '      "deep": [3]\n'
        "    }\n"
        "  ],\n"
        '  "lists": [\n'
        "    [1, 2],\n"
        "    [3]\n"
        "  ]\n"
        "}\n"
    )
    assert json_text([1, 2]) == "[1, 2]"


def test_keys_without_a_value_are_left_out_of_the_text() -> None:
    text = board_text(table_of(FEW)[1])
    assert text.startswith('{\n  "skin": "palm",\n  "bus": "end",\n')
    assert not {"data_bitrate", "frontend", "companding", "level", "state"} & set(text.replace('"', " ").split())
