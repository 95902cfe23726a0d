"""A whole skin of 128 nodes on four buses of a real kernel."""

from collections.abc import Iterator

import numpy as np
import pytest

from skin.messages import GatewayStatus
from tests.vcan.chain import Chain, complete, running_chain


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chain]:
    with running_chain(tmp_path_factory.mktemp("chain")) as started:
        yield started


@pytest.fixture(autouse=True)
def _from_a_whole_skin(chain: Chain) -> None:
    chain.await_complete()


def balance(status: GatewayStatus) -> int:
    used = status.frames_accepted + status.frames_late + status.frames_duplicate + status.frames_malformed
    return status.frames_received - used


def test_measurements_are_complete_and_equal_the_sums_the_nodes_computed(chain: Chain) -> None:
    measured = chain.await_cycles(30)
    assert sum(map(complete, measured)) >= 28  # the guest may be held up once
    assert [each.cycle for each in measured] == list(range(measured[0].cycle, measured[0].cycle + 30))
    for measurement in filter(complete, measured):
        sums = np.frombuffer(measurement.sums, "<i4")
        assert np.array_equal(sums, chain.true_sums(measurement))
        assert measurement.fingerprint == chain.phi.fingerprint
    assert any(np.frombuffer(each.sums, "<i4").any() for each in measured)
