"""The test vectors of ``skin contract``: a file for one node of each type."""

from dbc.contract import Contract
from dbc.eds import node_name, node_types
from dbc.generate import VECTOR_FOLDER
from dbc.vectors import vectors_text
from nodes.adaptive.vectors import adaptive_vectors_text


def vector_files(contract: Contract) -> dict[str, str]:
    """Return the test vectors of one node of each type by their path."""
    text = adaptive_vectors_text if contract.layout.sending == "adaptive" else vectors_text
    nodes = [kind.nodes[0] for kind in node_types(contract)]
    return {f"{VECTOR_FOLDER}/{node_name(contract, node)}.json": text(contract, node) for node in nodes}
