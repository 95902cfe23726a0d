"""The contourlet's synthesis Ψ and its transpose Ψᵀ, compiled.

Samples are in the orders of `reconstructor.kernels.contourlet_tables`.
"""

from reconstructor.bases.pkva import ROOT_TWO
from reconstructor.kernels.contourlet_tables import ContourletBuffers, ContourletTables, Phases
from reconstructor.kernels.steps import gather
from reconstructor.kernels.transforms import FAST_MATH, Flat
from shell.compiled import njit

# Compiled functions take no keyword arguments.


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def synthesise(image: Flat, coefficients: Flat, tables: ContourletTables, buffers: ContourletBuffers) -> None:
    """Set image = Ψ coefficients: x = d + U (c - D d Dᵀ) Uᵀ of d = F⁻¹ s_d."""
    count = image.size
    work = buffers.image
    work[:] = coefficients[count // 4 :]
    for number in range(len(tables.geometry) - 1, -1, -1):
        _ladder(work, number, tables, buffers)
        gather(buffers.other, work, tables.returns[number])
        work[:] = buffers.other
    coarse = buffers.half[: count // 4]
    _coarsen(coarse, work, tables.low, tables, buffers)
    for k in range(coarse.size):
        coarse[k] = coefficients[k] - coarse[k]
    _refine(image, coarse, tables.high, tables, buffers)
    for k in range(count):
        image[k] += work[k]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def transpose(coefficients: Flat, image: Flat, tables: ContourletTables, buffers: ContourletBuffers) -> None:
    """Set coefficients = Ψᵀ image: c = Uᵀ x U, and the transposed bank of x - Dᵀ c D."""
    count = image.size
    coarse, work = coefficients[: count // 4], coefficients[count // 4 :]
    _coarsen(coarse, image, tables.high, tables, buffers)
    _refine(buffers.image, coarse, tables.low, tables, buffers)
    for k in range(count):
        buffers.image[k] = image[k] - buffers.image[k]
    for number in range(len(tables.geometry)):
        gather(work, buffers.image, tables.gathers[number])
        _ladder(work, number, tables, buffers)
        if number + 1 < len(tables.geometry):
            buffers.image[:] = work


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _ladder(work: Flat, number: int, tables: ContourletTables, buffers: ContourletBuffers) -> None:
    """Run the two steps of one level, the same both ways: b ← -(b + F a) / √2, a ← √2 a + Fᵀ b."""
    size = work.size // 2
    first, second, made = work[:size], work[size:], buffers.half
    root_two = work.dtype.type(ROOT_TWO)
    root_half = work.dtype.type(ROOT_TWO / 2)
    _fan(made, first, number, tables, buffers)
    for k in range(size):
        second[k] = -root_half * (second[k] + made[k])
    _fan_transposed(made, second, number, tables, buffers)
    for k in range(size):
        first[k] = root_two * first[k] + made[k]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _fan(target: Flat, source: Flat, number: int, tables: ContourletTables, buffers: ContourletBuffers) -> None:
    """Filter every band: from (columns, rows, bands) to (rows, bands, columns)."""
    bands, rows, columns, count = tables.geometry[number]
    long, wide = buffers.long, buffers.wide
    _wrap(wide, source, rows * bands, columns, 5, 12)
    _filter(target, wide, tables.across, rows * bands, 12)
    above = 5 if count == 12 else 0
    middle = long[above * bands * columns : (above + rows) * bands * columns]
    gather(middle, target, tables.turns[number, 0])
    _wrap_rows(long, rows, bands * columns, above, count, number == 0)
    _filter(target, long, tables.along[number, 0], bands * columns, count)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _fan_transposed(
    target: Flat, source: Flat, number: int, tables: ContourletTables, buffers: ContourletBuffers
) -> None:
    """Filter every band by the transpose: from (rows, bands, columns) to (columns, rows, bands)."""
    bands, rows, columns, count = tables.geometry[number]
    long, wide = buffers.long, buffers.wide
    above = 6 if count == 12 else 0
    _copy(long[above * bands * columns : (above + rows) * bands * columns], source)
    _wrap_rows(long, rows, bands * columns, above, count, number == 0)
    _filter(target, long, tables.along[number, 1], bands * columns, count)
    middle = wide[6 * rows * bands : (6 + columns) * rows * bands]
    gather(middle, target, tables.turns[number, 1])
    _wrap_rows(wide, columns, rows * bands, 6, 12, False)
    _filter(target, wide, tables.across, rows * bands, 12)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _copy(target: Flat, source: Flat) -> None:
    for k in range(target.size):
        target[k] = source[k]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _wrap(target: Flat, source: Flat, size: int, rows: int, before: int, count: int) -> None:  # noqa: PLR0917
    """Copy `rows` rows of `size`, periodically extended by `before` rows ahead and behind for `count` taps."""
    _copy(target[before * size : (before + rows) * size], source)
    _wrap_rows(target, rows, size, before, count, False)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _wrap_rows(long: Flat, rows: int, size: int, above: int, count: int, quincunx: bool) -> None:  # noqa: PLR0917
    """Fill the rows above and below the middle periodically; in a quincunx shifted by half the width."""
    end, below = above + rows, count - 1 - above
    if not quincunx and above <= rows and below <= rows:
        _copy(long[: above * size], long[rows * size :])
        _copy(long[end * size : (end + below) * size], long[above * size :])
        return
    half = size // 2
    for i in range(rows + count - 1):
        if above <= i < end:
            continue
        wraps, row = divmod(i - above, rows)
        line, seen = long[i * size : (i + 1) * size], long[(above + row) * size : (above + row + 1) * size]
        if quincunx and wraps % 2:
            _copy(line[:half], seen[half:])
            _copy(line[half:], seen)
        else:
            _copy(line, seen)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _filter(target: Flat, source: Flat, taps: Flat, size: int, count: int) -> None:
    """Set target = Σ taps[t] · source moved by t rows of `size`, for the first `count` taps, a multiple of four."""
    for t in range(0, count, 4):
        a, b, c, d = taps[t], taps[t + 1], taps[t + 2], taps[t + 3]
        p, q = source[t * size :], source[(t + 1) * size :]
        r, s = source[(t + 2) * size :], source[(t + 3) * size :]
        if t == 0:
            for k in range(target.size):
                target[k] = (a * p[k] + b * q[k]) + (c * r[k] + d * s[k])
        else:
            for k in range(target.size):
                target[k] += (a * p[k] + b * q[k]) + (c * r[k] + d * s[k])


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _coarsen(coarse: Flat, image: Flat, phases: Phases, tables: ContourletTables, buffers: ContourletBuffers) -> None:
    """Filter and halve rows, then columns; the result is transposed."""
    size = tables.size
    made = buffers.other[: size * size // 2]
    _halve(made, image, phases, size, buffers)
    turned = buffers.other[size * size // 2 :]
    gather(turned, made, tables.flips[0])
    _halve(coarse, turned, phases, size // 2, buffers)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _refine(image: Flat, coarse: Flat, phases: Phases, tables: ContourletTables, buffers: ContourletBuffers) -> None:
    """Upsample and filter the columns, then the rows, of a transposed coarse image."""
    size = tables.size
    made = buffers.other[: size * size // 2]
    _double(made, coarse, phases, size // 2, buffers)
    turned = buffers.other[size * size // 2 :]
    gather(turned, made, tables.flips[1])
    _double(image, turned, phases, size, buffers)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _halve(target: Flat, source: Flat, phases: Phases, width: int, buffers: ContourletBuffers) -> None:
    """Set target[i] = Σ even[k] source[2i + 2k] + Σ odd[k] source[2i + 2k + 1]; rows of `width`, even rows first."""
    half = target.size
    rows = half // width
    _wrap(buffers.long, source[:half], width, rows, phases.before[0], phases.even.size)
    _filter(target, buffers.long, phases.even, width, phases.even.size)
    _wrap(buffers.long, source[half:], width, rows, phases.before[1], phases.odd.size)
    other = buffers.wide[:half]
    _filter(other, buffers.long, phases.odd, width, phases.odd.size)
    for k in range(half):
        target[k] += other[k]


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _double(target: Flat, source: Flat, phases: Phases, width: int, buffers: ContourletBuffers) -> None:
    """Apply the transpose of `_halve`, by the symmetry of the taps."""
    half = source.size
    rows = half // width
    _wrap(buffers.long, source, width, rows, phases.before[0], phases.even.size)
    _filter(target[:half], buffers.long, phases.even, width, phases.even.size)
    _wrap(buffers.long, source, width, rows, phases.before[1] - 1, phases.odd.size)
    _filter(target[half:], buffers.long, phases.odd, width, phases.odd.size)
