"""The sampling instant on a real kernel: as the nodes had it, by kernel time stamps."""

from pathlib import Path

import numpy as np

from canskin.messages import UNKNOWN_ERROR_NS
from tests.vcan.chain import running_chain

CYCLES = 50
#: The two processes convert kernel stamps by offsets of their own.
STEP_NS = 20_000


def test_the_sampling_instant_is_that_of_the_nodes(tmp_path: Path) -> None:
    with running_chain(tmp_path) as chain:
        known = chain.await_known(CYCLES)
        errors_ns = []
        for each in known:
            truth = chain.truth_of(each)
            assert truth is not None
            bus_ns = np.frombuffer(each.bus_sampled_ns, "<i8")
            # The nodes of all buses are one process: its truth is of the bus that it read first.
            by_stamp_ns = np.abs(bus_ns - truth.sampled_mono_ns).min()
            errors_ns.append((by_stamp_ns, abs(each.sent_mono_ns - truth.sampled_mono_ns), each.sampled_error_ns))
            # On vcan a SYNC takes no time: its stamp may be too early to prove a bound.
            if each.sampled_error_ns != UNKNOWN_ERROR_NS:
                assert abs(each.sampled_mono_ns - truth.sampled_mono_ns) <= each.sampled_error_ns + STEP_NS
        assert sum(bound_ns != UNKNOWN_ERROR_NS for _, _, bound_ns in errors_ns) > len(errors_ns) // 2
        with_stamps, without, bound = np.percentile(errors_ns, 99, axis=0) / 1000
        print(
            f"sampling instant, 99 %: {with_stamps:.1f} us with kernel stamps, {without:.1f} us without, "
            f"bound {bound:.1f} us"
        )
        assert with_stamps < 100
        assert with_stamps < without
