"""Φ of an SBHE: an exact operator with orthogonal rows of ±1."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import InputError
from skin.phi import Sbhe, fast_hadamard, sbhe


@st.composite
def operators(draw: st.DrawFn) -> Sbhe:
    block_size = 2 ** draw(st.integers(1, 8))
    blocks = draw(st.integers(1, 6))
    taxels = block_size * blocks - draw(st.integers(0, block_size - 1))
    seed = draw(st.integers(0, 2**32 - 1))
    gaps = np.array(sorted(draw(st.sets(st.integers(0, taxels + 9), min_size=10, max_size=10))))
    if draw(st.booleans()):
        sums = draw(st.integers(1, block_size * blocks))
        return sbhe(taxels + 10, sums, block_size=block_size, gaps=gaps, selection="uniform", seed=seed)
    if draw(st.booleans()):
        sums = draw(st.integers(1, block_size).map(lambda each: blocks * each) | st.integers(1, blocks))
        return sbhe(taxels, sums, block_size=block_size, seed=seed)
    sums = draw(st.integers(1, block_size * blocks))
    return sbhe(taxels, sums, block_size=block_size, selection="uniform", seed=seed)


def dense(phi: Sbhe) -> np.ndarray:
    """Φ over all places, from its definition: (-1)^(number of common bits) at the places of the block."""
    matrix = np.zeros((phi.shape[0], phi.wired.shape[1]))
    for index, (block, row) in enumerate(zip(phi.block_of_sum, phi.row_of_sum, strict=True)):
        for place in range(phi.block_size):
            place_or_taxel = phi.order[block * phi.block_size + place]
            matrix[index, place_or_taxel] = (-1) ** (int(row) & place).bit_count()
    return matrix


@given(operators())
@settings(max_examples=30, deadline=None)
def test_equals_its_definition_and_has_orthogonal_rows(phi: Sbhe) -> None:
    matrix = dense(phi)
    x = np.random.default_rng(0).normal(size=phi.shape[1])
    np.testing.assert_allclose(phi.forward(x), matrix[:, : x.size] @ x, atol=1e-12)
    np.testing.assert_allclose(phi.wired.forward(phi.padded(x)), phi.forward(x), atol=1e-12)
    assert np.array_equal(matrix @ matrix.T, phi.block_size * np.eye(phi.shape[0]))


@given(st.integers(1, 16), st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_few_sums_have_the_bits_that_they_have_among_all(sums: int, seed: int) -> None:
    phi = sbhe(512, sums, seed=seed)
    x = np.random.default_rng(seed).normal(size=(2, 512)).astype(np.float32)
    among_all = fast_hadamard(x[:, phi.taxels_of_blocks])[:, phi.kept]
    assert phi.forward(x).tobytes() == among_all.tobytes()


@given(operators(), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_dot_product(phi: Sbhe, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=phi.shape[1]), rng.normal(size=phi.shape[0])
    assert phi.forward(x) @ y == pytest.approx(x @ phi.adjoint(y), rel=1e-10, abs=1e-10)


@given(operators(), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_integers_are_exact(phi: Sbhe, seed: int) -> None:
    bits = 15 - (phi.block_size.bit_length() - 1)  # as many as a layout allows
    counts = np.random.default_rng(seed).integers(0, 2**bits, (3, phi.shape[1]), dtype=np.uint16)
    counts[0] = 2**bits - 1
    assert np.array_equal(phi.forward(counts), phi.forward(counts.astype(np.float64)))


def test_balanced_blocks_send_alike_and_uniform_ones_do_not() -> None:
    assert set(np.diff(sbhe(4096, 1024).starts)) == {8}
    uniform = sbhe(4096, 1024, selection="uniform")
    assert uniform.shape == (1024, 4096)
    assert len(set(np.diff(uniform.starts))) > 1
    assert [len(uniform.rows_of(block)) for block in range(3)] == list(np.diff(uniform.starts)[:3])


def test_seed_and_fingerprint_tell_operators_apart() -> None:
    assert sbhe(4096, 1024, seed=1).fingerprint == sbhe(4096, 1024, seed=1).fingerprint
    others = [
        sbhe(4096, 1024, seed=1),
        sbhe(4096, 1024, seed=2),
        sbhe(4096, 896, seed=1),
        sbhe(4096, 1024, seed=1, selection="uniform"),
        sbhe(4096, 1024, seed=1, block_size=16),
    ]
    for one, other in itertools.combinations(others, 2):
        assert one.fingerprint != other.fingerprint


def test_validity_of_blocks_spreads_to_their_sums() -> None:
    phi = sbhe(256, 40, selection="uniform")
    valid = np.arange(phi.blocks) % 2 == 0
    assert np.array_equal(phi.sums_of_blocks(valid), phi.block_of_sum % 2 == 0)


@pytest.mark.parametrize(("taxels", "sums", "block_size"), [(100, 129, 32), (96, 0, 32), (96, 97, 32), (96, 10, 24)])
def test_sizes_that_do_not_fit(taxels: int, sums: int, block_size: int) -> None:
    with pytest.raises(InputError, match=r"1 to 128 sums|1 to 96 sums|power of two"):
        sbhe(taxels, sums, block_size=block_size, selection="uniform")


def test_balanced_needs_a_multiple() -> None:
    with pytest.raises(InputError, match="multiple of 3 blocks"):
        sbhe(96, 10)


@given(operators())
@settings(max_examples=30, deadline=None)
def test_blocks_with_and_without_sums(phi: Sbhe) -> None:
    sums = np.arange(1, phi.shape[0] + 1)
    total = [sums[phi.block_of_sum == block].sum() for block in range(phi.blocks)]
    assert phi.total_of_blocks(sums).tolist() == total
    assert phi.has_sums.tolist() == [each > 0 for each in total]
    odd = [all(each % 2 for each in sums[phi.block_of_sum == block]) for block in range(phi.blocks)]
    assert phi.all_of_blocks(sums % 2 == 1).tolist() == odd


@pytest.mark.parametrize("sums", [1, 16, 64, 100, 127])
def test_fewer_balanced_sums_than_blocks_are_spread_evenly(sums: int) -> None:
    phi = sbhe(4096, sums, seed=5)
    assert phi.shape[0] == sums
    assert phi.kept.sum(axis=1).max() == 1
    before = np.concatenate(([0], np.cumsum(phi.has_sums)))
    assert np.abs(before - np.arange(129) * sums / 128).max() <= 1
    assert phi.fingerprint == sbhe(4096, sums, seed=5).fingerprint != sbhe(4096, sums, seed=6).fingerprint


@given(operators())
def test_every_block_has_its_share_of_the_taxels(phi: Sbhe) -> None:
    held = [phi.taxels_of(block) for block in range(phi.blocks)]
    assert np.ptp([len(each) for each in held]) <= 1
    assert sorted(np.concatenate(held).tolist()) == np.flatnonzero(phi.is_wired).tolist()
    of_taxels = phi.of_taxels(np.arange(1, phi.blocks + 1))
    np.testing.assert_array_equal(of_taxels, np.where(phi.is_wired, phi.block_of_taxel + 1, 0))
    assert (phi.order[phi.place_of_taxel[phi.is_wired]] == np.flatnonzero(phi.is_wired)).all()
    assert all((phi.block_of_taxel[each] == block).all() for block, each in enumerate(held))
