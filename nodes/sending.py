"""What depends on how the nodes of a skin send their sums (`sending` of a layout), in one place."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from dbc.contract import Contract, NodeContract
from dbc.eds import node_name, node_types
from dbc.generate import VECTOR_FOLDER
from dbc.vectors import vectors_text
from nodes.firmware.library import Firmware
from nodes.hardware import Hardware
from nodes.node import SkinNode
from nodes.sampler import new_sampler
from nodes.steps.boards import SteppedBoards
from nodes.steps.firmware import FirmwarePatches
from nodes.steps.node import SteppedNode
from nodes.steps.vectors import stepped_vectors_text
from skin.layout import Layout
from skin.sources import TaxelSource


@dataclass(frozen=True)
class NodeSending:
    """What one way of sending (`skin.ways_of_sending.Sending`) makes of nodes.

    Attributes
    ----------
    node : type of SkinNode
        A node in Python.
    hardware : callable
        Returns what samples the taxels of some nodes, from contract, blocks of the nodes (ascending), source of touch,
        firmware (compiled for these nodes: the boards in C make the sums; or None), and ``noise_n``, ``seed`` and
        ``defects`` of `nodes.electronics.Electronics`.
    vectors_text : callable
        Returns the test vectors of a node as JSON.
    """

    node: type[SkinNode]
    hardware: Callable[..., Hardware]
    vectors_text: Callable[[Contract, NodeContract], str]


def sending_of(layout: Layout) -> NodeSending:
    """Return what the way of sending of a layout makes of its nodes."""
    return _SENDINGS[layout.sending]


def _sampler(
    contract: Contract, _blocks: Sequence[int], source: TaxelSource, firmware: Firmware | None, **analogue: Any
) -> Hardware:
    if source.has_noise:
        analogue = {**analogue, "noise_n": 0.0}
    return new_sampler(contract.layout, contract.phi, source, makes_sums=firmware is None, **analogue)


def _patches(
    contract: Contract, blocks: Sequence[int], source: TaxelSource, firmware: Firmware | None, **analogue: Any
) -> Hardware:
    if firmware is None:
        return SteppedBoards(contract, blocks, source, **analogue)
    return FirmwarePatches(contract, blocks, source, firmware, **analogue)


def vector_files(contract: Contract) -> dict[str, str]:
    """Return the test vectors of one node of each type by their path."""
    text = sending_of(contract.layout).vectors_text
    nodes = [kind.nodes[0] for kind in node_types(contract)]
    return {f"{VECTOR_FOLDER}/{node_name(contract, node)}.json": text(contract, node) for node in nodes}


_SENDINGS: Final = {
    "synchronous": NodeSending(SkinNode, _sampler, vectors_text),
    "steps": NodeSending(SteppedNode, _patches, stepped_vectors_text),
}
