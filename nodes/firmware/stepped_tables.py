"""Numbers of boards that send steps as C: ``stepped.h`` and ``stepped.c``, the same for all boards of a skin."""

from collections.abc import Iterable
from typing import Final

import numpy as np

from dbc import patch_filter, steps
from dbc.contract import Contract
from dbc.patch_filter import SPANS, unclip_table
from nodes.firmware.c_text import WRITTEN, array, braced, defined, double, header, real
from nodes.firmware.contract_header import whole_numbers
from nodes.steps.stepping import LOST_NS
from skin.clipping import DEAD_RATIO
from skin.walsh import grouped_rows, haar_matrix, patch_shape, walsh_matrix

#: Numbers of `dbc.patch_filter` that C has under the same names, with ``SKIN_`` before them.
_REALS: Final = {
    "ROOT_HALF": "square root of 1/2",
    "FOLLOWING": "part of what is left that an offset follows",
    "RATE_N": "most that an offset falls in a sample",
    "RETURN_N": "most that an offset rises in a sample below that of power-up",
    "RISE_N": "most that an offset rises in a sample above that of power-up",
    "HIGHEST_N": "highest offset above that of power-up",
    "QUIET_RATIO": "of the noise: a taxel is quiet below",
    "LOWEST_RATIO": "of the noise: lowest offset",
    "IDLE_PART": "part of the taxels that have to be idle",
}


def stepped_header(contract: Contract) -> str:
    """Return ``stepped.h``: the numbers of words, slots and filter, with ``SKIN_`` before their names in Python."""
    high, wide = patch_shape(contract.phi.block_size)
    least_n, most_n = patch_filter.GIVEN_NOISE_N
    period_ns = round(contract.layout.sync.period_s * 1e9)
    unclip_scale = (patch_filter.UNCLIP_POINTS - 1) / patch_filter.UNCLIP_REACH
    values: dict[str, tuple[object, str]] = {
        "SKIN_PATCH_HIGH": (high, "taxels of a board"),
        "SKIN_PATCH_WIDE": (wide, "side by side"),
        "SKIN_BLOCK_SUMS": (high * wide, "taxels of a board, row by row, and sums in the order of the words"),
        "SKIN_UNIT_N": (double(contract.unit_n), "of the sums (2007h)"),
        "SKIN_SCALES": (braced(map(str, steps.SCALES)), "of steps, units"),
        "SKIN_NOISE_RATIO": (double(steps.NOISE_RATIO), "of the noise that is worth no word"),
        "SKIN_VARIANCE_RATIO": (double(steps.VARIANCE_RATIO), "of the variance that is worth no word"),
        "SKIN_LOST_NS": (LOST_NS, "a frame that was neither sent nor given up in this time is lost"),
        "SKIN_SYNC_PERIOD_NS": (period_ns, "from SYNC to SYNC"),
        "SKIN_NEWTON_PER_COUNT": (double(contract.layout.taxels.newton_per_count), "of a taxel"),
        "SKIN_LEAST_NOISE_N": (double(patch_filter.LEAST_NOISE_N), "least noise"),
        **{f"SKIN_{name}": (real(getattr(patch_filter, name)), meaning) for name, meaning in _REALS.items()},
        "SKIN_SPAN_COUNT": (len(SPANS), "lengths of the means in which noise is looked at"),
        "SKIN_SPANS": (braced(map(str, SPANS)), "these lengths, samples"),
        "SKIN_LEAST_GIVEN_NOISE_N": (real(least_n), "least noise that may be given, besides 0"),
        "SKIN_MOST_GIVEN_NOISE_N": (real(most_n), "and most"),
        "SKIN_UNCLIP_SCALE": (real(unclip_scale), "points per standard deviation"),
        "SKIN_DEAD_RATIO": (real(DEAD_RATIO), "of the noise: forces below are 0"),
        "SKIN_LEAST_IDLE_RATIO": (real(patch_filter.IDLE_RATIOS[0]), "mean over deviation of an idle taxel, least"),
        "SKIN_MOST_IDLE_RATIO": (real(patch_filter.IDLE_RATIOS[1]), "and most"),
    }
    numbers = whole_numbers(patch_filter) | whole_numbers(steps)
    lines = [*(f"#define SKIN_{name} ({value})" for name, value in numbers.items()), *defined(values)]
    comment = f"Numbers of boards of the skin {contract.layout.name} that send steps."
    return header("STEPPED_H", comment, ["#include <stdint.h>", "", '#include "contract.h"', "", *lines])


def stepped_source(contract: Contract) -> str:
    """Return ``stepped.c``: the tables of the filter."""
    taxels = contract.phi.block_size
    first, size = _bands(taxels)
    bytes_: dict[str, Iterable[int]] = {
        "skin_row_of_sum": grouped_rows(taxels).ravel().tolist(),
        "skin_band_of_sum": first,
        "skin_band_size": size,
    }
    lines = [
        *array("const float", "skin_unclip_table", map(real, unclip_table()), per_line=6),
        *(line for name, each in bytes_.items() for line in array("const uint8_t", name, each)),
    ]
    comment = f"/* Tables of boards of the skin {contract.layout.name} that send steps. {WRITTEN} */"
    return "\n".join([comment, '#include "skin_filter.h"', "", *lines, ""])


def _bands(taxels: int) -> tuple[list[int], list[int]]:
    """Return the first Haar coefficient, and the number of coefficients, that a sum's variance comes from."""
    share = np.rint(np.square(haar_matrix(taxels) @ walsh_matrix(taxels).T)) > 0
    return share.argmax(axis=0).tolist(), share.sum(axis=0).tolist()
