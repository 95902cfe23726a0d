"""What adaptive nodes send of a touch on a bus that takes every frame at once: for plans, without a running bus."""

from typing import Any

import numpy as np

from dbc.adaptive import LEVELS, Companding, SendingRule, decode_cob_id
from dbc.adaptive_filter import SAMPLE_NS
from dbc.contract import Contract, frame_flags
from dbc.frame import Frames, frames
from nodes.adaptive.filtering import settled_filter
from nodes.adaptive.sending import (
    NOT_DUE,
    Groups,
    decide,
    identifier_of,
    make_payload,
    most_urgent,
    new_groups,
    noise_threshold_n2,
    note_sent,
)
from nodes.adaptive.sensors import PatchSensors
from nodes.electronics import Calibration
from skin.compiled import njit
from skin.sources import TaxelSource
from skin.taxel import TaxelModel
from skin.walsh import GROUPS


def touched_frames(contract: Contract, bus: int, source: TaxelSource, seconds: float, seed: int = 0) -> Frames:
    """Return the frames of sums that the nodes of bus number `bus` send, with the times of their samples.

    Parameters
    ----------
    contract : Contract
        Of a layout with adaptive sending.
    source : TaxelSource
        Touch in steps of 10 ms.
    seconds : float
    seed : int
        Of noise and clocks.
    """
    calibration, nodes = Calibration(contract.layout.taxels), contract.on_bus(bus)
    cells = contract.phi.taxels_of_blocks[[node.block for node in nodes]]
    model = TaxelModel(force_max_n=contract.layout.taxels.force_max_n)
    sensors = PatchSensors(calibration, cells, model, source, seed)
    patch_filter = settled_filter(lambda: sensors.sample(0))
    sensors.touch_from_ns = 0
    line = contract.layout.bus[bus]
    rule, groups = SendingRule(), new_groups(len(nodes), line.fd)
    samples = round(seconds * 1000)
    parts, part = [], frames(GROUPS * len(nodes))
    part["flags"] = frame_flags(line)
    for now in range(samples):
        patch_filter.take(sensors.sample(now * SAMPLE_NS))
        noise_n2 = noise_threshold_n2(patch_filter.noise.node_n, rule.noise_ratio)
        sums = patch_filter.sums_n, patch_filter.variance_n2, noise_n2
        count = _send(now, *sums, rule, contract.law, groups, part["can_id"], part["length"], part["data"])
        if count:
            part["time_ns"][:count] = now * SAMPLE_NS
            parts.append(part[:count].copy())
    return np.concatenate(parts) if parts else frames(0)


@njit(cache=True, nogil=True)
def _send(  # noqa: PLR0917  compiled functions take no keywords
    now: int,
    sums_n: Any,
    variance_n2: Any,
    noise_n2: Any,
    rule: SendingRule,
    law: Companding,
    groups: Groups,
    identifiers: Any,
    lengths: Any,
    payloads: Any,
) -> int:
    """Write the frames that are due; return how many."""
    count = 0
    for node in range(sums_n.shape[0]):
        decide(node, now, sums_n[node], variance_n2[node], noise_n2[node], rule, law, groups)
        while True:
            group = most_urgent(node, groups)
            if group == NOT_DUE:
                break
            identifiers[count] = identifier_of(node, group, groups)
            kind, tpdo_group, _ = decode_cob_id(identifiers[count], groups.is_fd[node])
            payload = payloads[count]
            payload[:] = 0
            lengths[count] = make_payload(node, group, sums_n[node], law, groups, payload)
            note_sent(node, tpdo_group, now, kind >= LEVELS, rule, law, groups, payload)
            count += 1
    return count
