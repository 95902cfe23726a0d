"""Images of the sums of any matrix: equal to those of an SBHE, and of codes that change from frame to frame."""

import numpy as np
import pytest

from canskin.errors import InputError
from canskin.messages import Contacts, Image
from reconstructor.engine import Reconstructor, reconstruct
from reconstructor.imaging import make_imager
from reconstructor.options import SolverOptions
from reconstructor.service import ReconstructorService
from reconstructor.settings import LIVE, PAPER, PRESETS, VARIATION
from skin.layout import parse_layout
from skin.matrix import MatrixPhi, signs_of
from skin.phi import sbhe
from skin.surface import Surface, grid_surface, surface_of_positions
from tests.layouts import layout_toml
from tests.messages import Published, measurement

SIDE = 10
FRAMES, SUMS = 300, 15
NO_GAPS = np.arange(0)
GRID: Surface = grid_surface(SIDE, SIDE, 0.004, NO_GAPS)


@pytest.fixture(scope="module")
def force_n() -> np.ndarray:
    """A bump of 10 mN that wanders over 10 x 10 taxels, 0.02 taxels a frame; shape (frames, n)."""
    k, i, j = np.indices((FRAMES, SIDE, SIDE))
    bump = 0.01 * np.exp(-((i - 2 - 0.02 * k) ** 2 + (j - 5) ** 2) / 4)
    return bump.reshape(FRAMES, -1).astype(np.float32)


@pytest.fixture(scope="module")
def codes() -> MatrixPhi:
    return MatrixPhi(np.random.default_rng(5).integers(0, 2, (FRAMES, SUMS, SIDE * SIDE)))


def sums_of(phi: MatrixPhi, force_n: np.ndarray, noise_n: float = 1e-4) -> np.ndarray:
    noise = np.random.default_rng(0).normal(0, noise_n, (len(force_n), phi.shape[0]))
    exact = [phi.of_cycle(cycle).forward(each) for cycle, each in enumerate(force_n, 1)]
    return (exact + noise).astype(np.float32)


def error_n(images: np.ndarray, force_n: np.ndarray) -> float:
    """Root mean square error after the first frames."""
    return float(np.sqrt(np.mean((images.reshape(force_n.shape) - force_n)[50:] ** 2)))


@pytest.mark.parametrize("solver", ["live", "variation"])
def test_a_matrix_that_is_an_sbhe_gives_its_images(force_n: np.ndarray, solver: str) -> None:
    phi = sbhe(SIDE * SIDE, 32, seed=3)
    matrix = MatrixPhi(phi.forward(np.eye(SIDE * SIDE)).T)
    sums_n, valid = sums_of(matrix, force_n), np.random.default_rng(1).random((FRAMES, 32)) > 0.05
    settings = PRESETS[solver]
    fast, dense = (reconstruct(sums_n, each, GRID, settings, valid_sums=valid) for each in (phi, matrix))
    np.testing.assert_allclose(dense, fast, atol=1e-6)
    assert fast.max() > 0.005


def test_the_memory_of_frames_with_other_codes_makes_the_image(force_n: np.ndarray, codes: MatrixPhi) -> None:
    """15 sums of 100 taxels: one frame alone tells little; the frames before, each with its own Φ, tell the rest."""
    sums_n = sums_of(codes, force_n)
    with_memory = reconstruct(sums_n, codes, GRID)
    alone = Reconstructor(codes, SIDE, SIDE, LIVE)
    whole = np.ones(SUMS, np.bool_)
    without = np.empty_like(with_memory)
    for place, each in enumerate(sums_n):
        alone.reset()
        without[place] = alone.solve(each, whole, codes.of_cycle(place + 1))
    one_code = MatrixPhi(codes.entries[0])
    fixed = reconstruct(sums_of(one_code, force_n), one_code, GRID)
    for name, images in (("memory", with_memory), ("one frame", without), ("one code", fixed)):
        print(f"{name}: {1e3 * error_n(images, force_n):.2f} mN")
    assert error_n(with_memory, force_n) < 0.0003
    assert error_n(with_memory, force_n) < error_n(without, force_n) / 4
    assert error_n(with_memory, force_n) < error_n(fixed, force_n) / 4


def test_lost_sums_and_frames_cost_little(force_n: np.ndarray, codes: MatrixPhi) -> None:
    sums_n, random = sums_of(codes, force_n), np.random.default_rng(2)
    valid = random.random(sums_n.shape) > 0.2
    lossy = np.where(valid, sums_n, np.nan).astype(np.float32)
    assert error_n(reconstruct(lossy, codes, GRID, valid_sums=valid), force_n) < 0.0004
    came = np.flatnonzero(random.random(FRAMES) > 0.2)
    images = reconstruct(sums_n[came], codes, GRID, cycles=came + 1)
    assert np.sqrt(np.mean((images.reshape(len(came), -1) - force_n[came])[50:] ** 2)) < 0.0004


def test_a_touch_that_is_gone_leaves_the_image_within_a_few_frames(force_n: np.ndarray, codes: MatrixPhi) -> None:
    lifted = np.where(np.arange(FRAMES)[:, None] < 100, force_n, 0)
    images = reconstruct(sums_of(codes, lifted, 0.0), codes, GRID)
    assert images[99].max() > 0.008
    assert images[120:].max() < 0.0005


def test_few_sums_with_noise_are_averaged_over_the_frames(force_n: np.ndarray) -> None:
    """7 codes of ±1 tell little: an image that fits them, noise and motion included, is off by 0.87 mN."""
    codes = MatrixPhi(2 * np.random.default_rng(5).integers(0, 2, (FRAMES, 7, SIDE * SIDE)) - 1)
    assert error_n(reconstruct(sums_of(codes, force_n, 1e-3), codes, GRID), force_n) < 0.0006


def test_gaps_have_no_force(force_n: np.ndarray) -> None:
    gaps = np.array([44, 45, 54, 55])
    is_wired = np.ones(SIDE * SIDE, np.bool_)
    is_wired[gaps] = False
    entries = np.random.default_rng(6).integers(0, 2, (40, SIDE * SIDE)) * is_wired
    phi = MatrixPhi(entries, is_wired)
    images = reconstruct(sums_of(phi, force_n), phi, grid_surface(SIDE, SIDE, 0.004, gaps)).reshape(FRAMES, -1)
    assert not images[:, gaps].any()
    assert error_n(images[:, is_wired], force_n[:, is_wired]) < 0.001


def test_what_does_not_fit_is_refused(codes: MatrixPhi) -> None:
    sums, whole = np.zeros(SUMS, np.float32), np.ones(SUMS, np.bool_)
    solver = Reconstructor(codes, SIDE, SIDE)
    with pytest.raises(InputError, match="expected the Φ of this frame where Φ changes"):
        solver.solve(sums, whole)
    with pytest.raises(InputError, match="expected the Φ of this frame where Φ changes"):
        solver.solve(sums, whole, MatrixPhi(np.ones((SUMS, 99))))
    with pytest.raises(InputError, match="solved with total variation, and forces of 0 or more: got 'haar-tensor'"):
        Reconstructor(codes, SIDE, SIDE, PAPER)
    with pytest.raises(InputError, match="Φ measures 100 taxels but the grid has 8 x 8 = 64"):
        Reconstructor(codes, 8, 8, VARIATION)


def test_the_service_takes_the_messages_of_other_hardware(force_n: np.ndarray, codes: MatrixPhi) -> None:
    """Each message is solved with the Φ of its cycle; a sum that did not come is left out alone."""
    tables = {"ensemble": "matrix", "matrix": signs_of(codes.entries)}
    layout = parse_layout(layout_toml(SIDE, SIDE, measurement=tables).encode(), "wire.toml")
    sent = Published()
    service = ReconstructorService(layout, make_imager(layout, SolverOptions()), sent)  # type: ignore[arg-type]
    counts = np.rint(sums_of(codes, force_n) / layout.taxels.newton_per_count).astype("<i4")
    valid = np.ones(SUMS, np.uint8)
    valid[4] = 0
    for cycle in [*range(1, 150), *range(160, FRAMES + 1)]:
        made = measurement(
            cycle, sums=counts[cycle - 1].tobytes(), valid=valid.tobytes(), sampled_mono_ns=10**7 * cycle
        )
        service.take(made)  # of another Φ
        service.take(
            measurement(
                cycle,
                **{name: getattr(made, name) for name in ("sums", "valid", "sampled_mono_ns")},
                fingerprint=codes.fingerprint,
            )
        )
    image, contacts = sent.of(Image)[-1], sent.of(Contacts)[-1]
    assert service.images == FRAMES - 10
    assert image.valid == valid.tobytes()
    assert image.valid_sums == SUMS - 1
    assert np.abs(np.frombuffer(image.pixels, "<f4") - force_n[-1]).max() < 0.0015
    (contact,) = contacts.contacts
    felt_n = np.where(force_n[-1] > 0.0005, force_n[-1], 0)
    row, column = (float(np.average(each.ravel(), weights=felt_n)) for each in np.indices((SIDE, SIDE)))
    assert (contact.row, contact.column) == pytest.approx((row, column), abs=0.1)


def test_neighbours_of_a_skin_that_is_no_grid(force_n: np.ndarray, codes: MatrixPhi) -> None:
    """The same taxels in another order, with positions: the same images in that order."""
    order = np.random.default_rng(8).permutation(SIDE * SIDE)
    positions = surface_of_positions(GRID.positions_m[order].tolist())
    sums_n = sums_of(codes, force_n)
    images = reconstruct(sums_n, MatrixPhi(codes.entries[..., order]), positions)
    expected = reconstruct(sums_n, codes, GRID).reshape(FRAMES, 1, -1)[..., order]
    assert images.shape == (FRAMES, 1, SIDE * SIDE)
    np.testing.assert_allclose(images, expected, atol=2e-4)
