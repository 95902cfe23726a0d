"""The test vectors for firmware are what virtual boards compute and send."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dbc import indices as od
from dbc.codec import encode
from dbc.contract import Contract
from dbc.generate import VECTOR_FOLDER
from nodes.electronics import Electronics
from nodes.sampler import Sampler
from nodes.sending import vector_files
from skin.layout import load_layout
from skin.sources import Frame


class Counts:
    """A source of forces that read as given counts."""

    has_noise = True

    def __init__(self, force_n: Any) -> None:
        self._force_n = force_n

    def frame(self, step: int) -> Frame:
        return Frame(self._force_n, "")


@pytest.mark.parametrize("name", ["fd", "one-bus-12bit"])
def test_a_virtual_board_matches_the_vectors(name: str) -> None:
    contract = Contract.from_layout(load_layout(Path(name)))
    taxels, node, table = contract.layout.taxels, contract.nodes[0], contract.table
    ((path, text),) = vector_files(contract).items()
    assert path == f"{VECTOR_FOLDER}/{contract.layout.bus[0].name}-001.json"
    cases = json.loads(text)["cases"]
    assert len({case["name"] for case in cases}) == len(cases) > 10
    for case in cases:
        electronics = Electronics(taxels, noise_n=0.0)
        counts = np.zeros(taxels.count, np.float32)
        chains = contract.phi.taxels_of_blocks[: node.blocks]
        counts[chains] = case["counts"]
        sampler = Sampler(contract.phi, Counts((counts * taxels.newton_per_count).reshape(64, 64)), electronics)
        for block in range(node.blocks):
            for index, values in ((od.GAIN, case["gain"]), (od.OFFSET, case["offset_counts"])):
                for subindex, value in enumerate(values[block], 1):
                    sampler.adjust(block, index, subindex, value)
            sampler.adjust(block, od.TEST_PATTERN, 0, case["pattern"])
        sums = sampler.sample(1, 0)
        assert electronics.sampled[chains].tolist() == case["corrected"]
        assert sums[: node.sums].tolist() == case["sums"], case["name"]
        assert case["sync_counter"] == 0xA5
        payloads = encode(case["sync_counter"], sums, table.gather, contract.packing)
        sent = {
            int(table.cob_id[row]): payloads[row, : table.length[row]].tobytes().ljust(table.length[row], b"\0").hex()
            for row in np.nonzero(table.node == 0)[0]
        }
        assert {frame["cob_id"]: frame["data"] for frame in case["frames"]} == sent


def test_a_fused_multiply_add_fails_a_vector() -> None:
    contract = Contract.from_layout(load_layout(Path("fd")))
    (text,) = vector_files(contract).values()
    (case,) = (each for each in json.loads(text)["cases"] if each["name"].startswith("product rounded"))
    exact = np.array(case["gain"]) * np.array(case["counts"]) + np.array(case["offset_counts"])
    assert (np.rint(exact.astype(np.float32)) != case["corrected"]).all()


def test_averages_have_vectors_away_from_ties() -> None:
    contract = Contract.from_layout(load_layout())
    (text,) = vector_files(contract).values()
    for case in json.loads(text)["cases"]:
        signs = np.array([contract.phi.row_of_sum[: contract.nodes[0].sums]])
        hadamard = 1 - 2 * (np.bitwise_count(signs.T & np.arange(32)) % 2).astype(int)
        exact = hadamard @ np.array(case["corrected"][0])
        assert np.rint(exact).astype(int).tolist() == case["sums"]
