"""The contract of adaptive nodes: identifiers by urgency, mapping, and a .dbc that other programs read."""

import struct
from typing import Any

import cantools
import numpy as np
import pytest

from canskin.errors import LayoutError
from dbc import indices as od
from dbc.adaptive import GROUP_SUMS, coarse_code, coarse_value, fine_steps, frame_of, pack_fine
from dbc.configuration import configuration
from dbc.contract import Contract
from dbc.database import database
from dbc.dictionary import dictionary
from dbc.eds import eds, node_types
from skin.layout import parse_layout
from skin.walsh import walsh_matrix
from tests.layouts import ADAPTIVE, GROUPS, TPDOS, buses, small_layout

TEXT = """
sending = "adaptive"
[taxels]
[measurement]
wiring = "board"
[sync]
rate_hz = 10.0
"""


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(parse_layout(TEXT.encode(), "adaptive.toml"))


@pytest.fixture(scope="module")
def small() -> Contract:
    """Two nodes on each of two buses: cantools takes its time to read what is said of many."""
    return Contract.from_layout(small_layout(8, 16, **ADAPTIVE, bus=buses(2, 2)))


def test_every_frame_of_a_bus_has_an_identifier_of_its_own(contract: Contract) -> None:
    identifiers = [tpdo.cob_id for node in contract.on_bus(2) for tpdo in node.adaptive_tpdos]
    assert sorted(identifiers) == list(range(0x181, 0x581))
    for node in contract.on_bus(2):
        for tpdo in node.adaptive_tpdos:
            assert frame_of(tpdo.cob_id, groups=GROUPS) == (node.node_id - 1, tpdo.level, tpdo.group, tpdo.is_fine)


def test_coarse_frames_go_first_and_the_most_urgent_of_them(contract: Contract) -> None:
    tpdos = sorted(contract.nodes[5].adaptive_tpdos, key=lambda tpdo: tpdo.cob_id)
    order = [(tpdo.is_fine, -tpdo.level, tpdo.group) for tpdo in tpdos]
    assert len(order) == TPDOS
    assert order == sorted(order)


def test_dictionary_maps_the_bytes_of_a_group(contract: Contract) -> None:
    entries = {(each.index, each.subindex): each.value for each in dictionary(contract, contract.nodes[0])}
    for tpdo in contract.nodes[0].adaptive_tpdos:
        record = 0x1800 + tpdo.number - 1
        assert entries[record, 1] == 1 << 30 | tpdo.cob_id
        assert (entries[record, 2], entries[record, 3]) == (254, 10)  # event-driven, 1 ms
        mapped = [entries[record + 0x200, place] for place in range(1, 1 + int(entries[record + 0x200, 0]))]
        if tpdo.is_fine:
            assert mapped == [od.FINE << 16 | tpdo.group + 1 << 8 | 64]
        else:
            assert mapped == [od.COARSE << 16 | 8 * tpdo.group + place << 8 | 8 for place in range(1, 9)]


def test_proof_covers_identifiers_and_mapping_of_all_frames(contract: Contract) -> None:
    covered = {(each.index, each.subindex) for each in configuration(contract, contract.nodes[0])}
    for number in range(TPDOS):
        assert {(0x1800 + number, 1), (0x1800 + number, 2), (0x1A00 + number, 0), (0x1A00 + number, 1)} <= covered


def test_proof_covers_what_frames_mean_and_not_what_a_node_learns(contract: Contract) -> None:
    settings = {(each.index, each.subindex): each for each in configuration(contract, contract.nodes[0])}
    assert {index for index, _ in settings if 0x2007 <= index < 0x2020} == {0x2007}
    assert not [index for index, _ in settings if 0x2030 <= index <= 0x2035]
    slopes = [struct.unpack("<f", settings[0x2007, place].data)[0] for place in (1, 3)]
    assert slopes == pytest.approx([contract.law.mean_slope, contract.law.slope])


def read(contract: Contract) -> Any:
    return cantools.database.load_string(database(contract, 1), "dbc", strict=True)


def test_cantools_decodes_the_codes_of_coarse_frames(small: Contract) -> None:
    contract, node, described = small, small.on_bus(1)[1], read(small)
    sums_n = walsh_matrix(32) @ np.random.default_rng(2).uniform(0, 0.02, 32)
    for group in range(GROUPS):
        tpdo = next(each for each in node.adaptive_tpdos if (each.group, each.level, each.is_fine) == (group, 4, False))
        values = sums_n[GROUP_SUMS * group :][:GROUP_SUMS]
        is_mean = [group == 0 and place == 0 for place in range(GROUP_SUMS)]
        codes = [coarse_code(value, mean, contract.law) for value, mean in zip(values, is_mean, strict=True)]
        signals = described.decode_message(tpdo.cob_id, bytes(codes))
        assert list(signals.values()) == codes
        first = int(contract.phi.starts[node.block])
        for name, value, code, mean in zip(signals, values, codes, is_mean, strict=True):
            row = int(name.split("Row")[1])
            exact = contract.phi.forward(_patch(contract, node.block, sums_n))[first + row]
            assert exact == pytest.approx(value, abs=1e-6)
            assert coarse_value(code, mean, contract.law) == pytest.approx(value, abs=0.5 * _step(value, contract))


def _patch(contract: Contract, block: int, sums_n: np.ndarray) -> np.ndarray:
    """Return a skin whose `block` has the sums `sums_n`, in the order of the groups."""
    skin = np.zeros(contract.layout.taxels.count)
    skin[contract.phi.order[32 * block : 32 * block + 32]] = walsh_matrix(32).T @ sums_n / 32
    return skin


def _step(value_n: float, contract: Contract) -> float:
    """Return a bound of the distance of codes at a value: both rows together."""
    law = contract.law
    return float(np.hypot(abs(value_n) + 0.005, law.mean_knee_n) / law.slope)


def test_cantools_decodes_the_bits_of_fine_frames(small: Contract) -> None:
    contract, described = small, read(small)
    tpdo = next(each for each in contract.on_bus(1)[0].adaptive_tpdos if each.is_fine)
    steps, payload = np.array([0, 1, -1, 63, -64, 100, 17, -30]), np.zeros(8, np.uint8)
    pack_fine(steps, 0xA5, payload)
    signals = described.decode_message(tpdo.cob_id, payload.tobytes())
    assert list(signals.values()) == [*(steps & 127).tolist(), 0xA5]
    assert fine_steps(0.001, contract.law) == 16  # of 62.5 µN


@pytest.mark.heavy
def test_one_eds_describes_all_boards(contract: Contract) -> None:
    (kind,) = node_types(contract)
    assert len(kind.nodes) == 128
    assert "NrOfTXPDO=32" in eds(contract, kind)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('wiring = "board"', 'wiring = "scattered"'), "$.measurement.wiring"),
        (('wiring = "board"', 'wiring = "board"\nblock_size = 128'), "$.measurement.block_size"),
        (
            ("[sync]", 'block_size = 64\n[[bus]]\nname = "a"\nnodes = 64\n[sync]'),
            "at most 16 nodes",
        ),
        (('wiring = "board"', 'wiring = "board"\nsums = 1024'), "$.measurement.sums"),
        (("rate_hz = 10.0", "rate_hz = 100.0"), "$.sync.rate_hz"),
        (("[sync]", "[sync]\nturns = 2"), "$.sync.turns"),
        (("[sync]", "[sampling]\nrate_hz = 500\n[sync]"), "$.sampling.rate_hz"),
        (("[sync]", '[[bus]]\nname = "a"\nnodes = 64\n[[bus]]\nname = "b"\nnodes = 64\n[sync]'), "$.bus[0]"),
        (("[sync]", '[[bus]]\nname = "a"\nnodes = 128\nfd = true\n[sync]'), "$.bus[0]"),
    ],
)
def test_layout_that_adaptive_sending_cannot_have_is_refused(change: tuple[str, str], words: str) -> None:
    with pytest.raises(LayoutError) as refused:
        parse_layout(TEXT.replace(*change).encode(), "adaptive.toml")
    assert words in str(refused.value)
