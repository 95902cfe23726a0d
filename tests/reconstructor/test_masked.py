"""What masked taxels read has no effect on images and contacts; there images have the mean of the neighbours."""

from typing import Any

import numpy as np
import pytest

from canskin.messages import Contacts, Image
from reconstructor.imaging import make_imager
from reconstructor.masked import MaskedTaxels
from reconstructor.service import ReconstructorService
from skin.layout import Layout, changed
from skin.measured_sums import MeasuredSums, SteppedSums
from tests.layouts import STEPPED, TWO_FINGERS, small_layout, tube_layout
from tests.messages import measurement

MASKED = (35, 36, 50)
LAYOUTS = {
    "cycles": small_layout(16, 16),
    "averages": small_layout(16, 16, sampling={"rate_hz": 1000.0}),
    "steps": small_layout(16, 16, **STEPPED),
    "positions": tube_layout(),
    "gaps": small_layout(12, 14, taxels={"shape": TWO_FINGERS}),
}


def counts_of(layout: Layout, reads: int | None = None) -> np.ndarray:
    """Return the counts of a touch; masked taxels read another value."""
    counts = np.random.default_rng(1).integers(0, 500, layout.taxels.count)
    if reads is not None:
        counts[list(MASKED)] = reads
    return counts


def images(layout: Layout, *reads: int | None) -> list[np.ndarray]:
    """Return the images of cycles in which the masked taxels read these counts."""
    imager, phi = make_imager(layout), layout.phi()
    valid, known = np.ones(phi.blocks, np.bool_), np.ones(phi.shape[0], np.bool_)
    made = []
    for cycle, each in enumerate(reads, 1):
        sums = np.asarray(phi.forward(counts_of(layout, each)), np.int32)
        kind: Any = (
            MeasuredSums(sums, valid, known, cycle) if layout.sends.in_cycles else SteppedSums(sums, valid, known, 1e-3)
        )
        made.append(imager.solve(kind)[0].copy())
    return made


@pytest.mark.parametrize("name", LAYOUTS)
def test_what_masked_taxels_read_has_no_effect_on_images(name: str) -> None:
    layout = changed(LAYOUTS[name], taxels={"masked": MASKED})
    calm, wild = images(layout, *[None] * 5), images(layout, 0, 1023, 7, 1023, 500)
    for one, other in zip(calm, wild, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-6)
    unmasked = images(LAYOUTS[name], *[None] * 4, 1023)[-1]
    assert np.abs(unmasked - images(LAYOUTS[name], *[None] * 5)[-1]).max() > 1e-3
    image, surface = calm[-1].ravel(), layout.taxels.surface
    assert image.max() > 2e-3
    for taxel in MASKED:
        pairs = surface.edges[(surface.edges == taxel).any(axis=1)]
        near = [each for each in np.unique(pairs).tolist() if each not in MASKED]
        assert image[taxel] == pytest.approx(image[near].mean() if near else 0.0, rel=1e-5)  # gaps have no neighbours


def test_a_block_with_no_more_sums_than_masked_taxels_tells_nothing() -> None:
    layout = changed(LAYOUTS["cycles"], taxels={"masked": (35,)})
    masked, phi = MaskedTaxels(layout), layout.phi()
    block = phi.block_of_taxel[35]
    first, last = phi.starts[block : block + 2]
    sums_n = np.ones(phi.shape[0], np.float32)
    for known, used in ((2, 2), (1, 0), (8, 8)):
        valid = np.ones(phi.shape[0], np.bool_)
        valid[first + known : last] = False
        found, found_valid = masked.apply(sums_n, valid)
        assert found_valid[first:last].sum() == used
        assert found_valid.sum() == valid.sum() - known + used
        np.testing.assert_array_equal(np.delete(found, np.s_[first:last]), 1)


def test_masked_taxels_of_a_contact_are_not_measured() -> None:
    layout = changed(LAYOUTS["cycles"], taxels={"masked": MASKED})
    phi, published = layout.phi(), []

    class Exchange:
        def publish(self, topic: Any, message: Any) -> None:
            published.append(message)

        def mailbox(self, *_: Any) -> None:
            """Nothing comes by itself."""

    service = ReconstructorService(layout, make_imager(layout), Exchange())  # type: ignore[arg-type]
    sums = np.asarray(phi.forward(np.full(256, 500)), "<i4")
    given = {"sums": sums.tobytes(), "valid": b"\1" * phi.blocks, "fingerprint": phi.fingerprint}
    service.take(measurement(1, **given))
    image, contacts = published
    assert isinstance(image, Image)
    assert all(image.valid)
    assert isinstance(contacts, Contacts)
    assert sum(each.invalid_taxels for each in contacts.contacts) == len(MASKED)
