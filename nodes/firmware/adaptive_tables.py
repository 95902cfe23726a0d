"""Numbers of adaptive boards as C: ``adaptive.h`` and ``adaptive.c``, the same for all boards of a skin.

The codes come as tables, so a board needs neither asinh nor sinh: the sum at which each code begins, to the last bit,
and the value of each code.
"""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from dbc.adaptive import MEAN_CODES, OTHER_CODES, Companding, SendingRule, coarse_code, coarse_value

from dbc import adaptive, adaptive_filter
from dbc.adaptive_filter import SPANS, unclip_table
from dbc.contract import Contract
from nodes.firmware.c_text import WRITTEN, array, braced, defined, double, header, real
from skin.clipping import DEAD_RATIO
from skin.sending import groups_of_frame
from skin.walsh import grouped_rows, haar_matrix, patch_shape, walsh_matrix

#: Numbers of `dbc.adaptive` and `dbc.adaptive_filter` that C has under the same names, with ``SKIN_`` before them.
_WHOLE: Final = {
    "GROUP_SUMS": "of a group",
    "LEVELS": "of urgency, of coarse frames",
    "FINE_LEVELS": "of fine frames",
    "KINDS": "and of both",
    "MEAN_CODES": "highest code of the first sum",
    "OTHER_CODES": "codes on each side of 0 of the others",
    "FINE_BITS": "of a sum in a fine frame",
    "FINE_REACH": "fine steps that these bits tell on each side",
    "FINE_LIMIT": "most fine steps from the coarse value that a frame is made for",
    "SAMPLE_NS": "time between two samples",
    "SAVED_FRAMES": "frames of each group that a budget may save up at least",
    "IDLE_SAMPLES": "samples from which the noise is learned",
    "SETTLING_SAMPLES": "samples that the filter has then seen",
    "UNCLIP_POINTS": "of the table that undoes clipping",
    "WINDOW": "samples over which the size of the noise is looked at",
}
_DOUBLES: Final = {
    "SAVING_S": "time for which a budget may be saved up",
    "LEAST_NOISE_N": "least noise",
    "LEAST_PART": "of the number whose logarithm the series tells",
}
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


def adaptive_header(contract: Contract) -> str:
    """Return ``adaptive.h``: the numbers of codes, filter and sending."""
    law, count_n = contract.law, contract.layout.taxels.newton_per_count
    reals = sum(1 << place for place, value in enumerate(SendingRule(), 1) if isinstance(value, float))
    high, wide = patch_shape(contract.phi.block_size)
    least_n, most_n = adaptive_filter.GIVEN_NOISE_N
    values: dict[str, tuple[object, str]] = {
        "SKIN_PATCH_HIGH": (high, "taxels of a board"),
        "SKIN_PATCH_WIDE": (wide, "side by side"),
        "SKIN_BLOCK_SUMS": (high * wide, "taxels of a board, row by row, and sums in the order of the frames"),
        "SKIN_GROUPS": (contract.layout.groups, "of the sums"),
        "SKIN_FD_GROUPS": (groups_of_frame(contract.layout.groups, is_fd=True), "that a CAN FD frame carries"),
        **{f"SKIN_{name}": (_number(name), meaning) for name, meaning in _WHOLE.items()},
        **{f"SKIN_{name}": (double(_number(name)), meaning) for name, meaning in _DOUBLES.items()},
        **{f"SKIN_{name}": (real(_number(name)), meaning) for name, meaning in _REALS.items()},
        **{f"SKIN_{name.upper()}": (double(value), "2007h") for name, value in law._asdict().items()},
        "SKIN_CRC_8": (f"0x{adaptive.CRC_8:X}u", "polynomial of the check"),
        "SKIN_NO_CHECK": (f"({adaptive.NO_CHECK})", "in place of a check: no coarse frame was sent"),
        "SKIN_NEWTON_PER_COUNT": (double(count_n), "of a taxel"),
        "SKIN_RULE_ENTRIES": (len(SendingRule()), "of 2031h"),
        "SKIN_RULE_REALS": (f"0x{reals:04X}u", "sub-indices of 2031h that are REAL32, a bit each"),
        "SKIN_LOST_SAMPLES": (
            adaptive.LOST_NS // adaptive_filter.SAMPLE_NS,
            "a frame that was neither sent nor given up in this time is lost",
        ),
        "SKIN_PAUSE_NS": (adaptive.PAUSE_MS * 1_000_000, "least time from a SYNC to the start of a frame of sums"),
        "SKIN_SPAN_COUNT": (len(SPANS), "lengths of the means in which noise is looked at"),
        "SKIN_SPANS": (braced(map(str, SPANS)), "these lengths, samples"),
        "SKIN_LEAST_GIVEN_NOISE_N": (
            real(least_n),
            "least noise that may be given, besides 0",
        ),
        "SKIN_MOST_GIVEN_NOISE_N": (real(most_n), "and most"),
        "SKIN_LOG2_SERIES": (braced(map(double, adaptive_filter.LOG2_SERIES)), "series of the logarithm of urgency"),
        "SKIN_UNCLIP_SCALE": (
            real((adaptive_filter.UNCLIP_POINTS - 1) / adaptive_filter.UNCLIP_REACH),
            "points per standard deviation",
        ),
        "SKIN_DEAD_RATIO": (real(DEAD_RATIO), "of the noise: forces below are 0"),
        "SKIN_LEAST_IDLE_RATIO": (real(adaptive_filter.IDLE_RATIOS[0]), "mean over deviation of an idle taxel, least"),
        "SKIN_MOST_IDLE_RATIO": (real(adaptive_filter.IDLE_RATIOS[1]), "and most"),
    }
    kinds = {float: "float", int: "uint32_t"}
    rule = [f"    {kinds[type(value)]} {name};" for name, value in SendingRule()._asdict().items()]
    return header(
        "ADAPTIVE_H",
        f"Numbers of adaptive boards of the skin {contract.layout.name}.",
        [
            "#include <stdint.h>",
            "",
            '#include "contract.h"',
            "",
            *defined(values),
            "",
            "/* 2031h, in the order of its sub-indices. */",
            "typedef struct {",
            *rule,
            "} skin_rule;",
        ],
    )


def _number(name: str) -> Any:
    """Return a number of `dbc.adaptive` or `dbc.adaptive_filter`."""
    return getattr(adaptive if hasattr(adaptive, name) else adaptive_filter, name)


def adaptive_source(contract: Contract) -> str:
    """Return ``adaptive.c``: the tables of codes and filter."""
    law, taxels = contract.law, contract.phi.block_size
    first, size = _bands(taxels)
    doubles: dict[str, Iterable[float]] = {
        "skin_mean_least": (_least(code, is_mean=True, law=law) for code in range(1, MEAN_CODES + 1)),
        "skin_mean_value": (coarse_value(code, True, law) for code in range(MEAN_CODES + 1)),
        "skin_other_least": (_least(code, is_mean=False, law=law) for code in range(1, OTHER_CODES + 1)),
        "skin_other_value": (coarse_value(OTHER_CODES + 1 + code, False, law) for code in range(OTHER_CODES + 1)),
    }
    bytes_: dict[str, Iterable[int]] = {
        "skin_row_of_sum": grouped_rows(taxels).ravel().tolist(),
        "skin_band_of_sum": first,
        "skin_band_size": size,
    }
    lines = [
        *array("const float", "skin_unclip_table", map(real, unclip_table()), per_line=6),
        *(
            line
            for name, each in doubles.items()
            for line in array("const double", name, map(double, each), per_line=4)
        ),
        *(line for name, each in bytes_.items() for line in array("const uint8_t", name, each)),
    ]
    comment = f"/* Tables of adaptive boards of the skin {contract.layout.name}. {WRITTEN} */"
    return "\n".join([comment, '#include "skin_filter.h"', "", *lines, ""])


def _bands(taxels: int) -> tuple[list[int], list[int]]:
    """Return the first Haar coefficient, and the number of coefficients, that a sum's variance comes from."""
    share = np.rint(np.square(haar_matrix(taxels) @ walsh_matrix(taxels).T)) > 0
    return share.argmax(axis=0).tolist(), share.sum(axis=0).tolist()


def _least(code: int, *, is_mean: bool, law: Companding) -> float:
    """Return the least sum, newtons, that has the code `code`, or for sums other than the mean 128 + `code`."""
    wanted = code if is_mean else OTHER_CODES + 1 + code
    low, high = 0.0, coarse_value(wanted, is_mean, law)
    while (middle := low + (high - low) / 2) not in (low, high):
        if coarse_code(middle, is_mean, law) < wanted:
            low = middle
        else:
            high = middle
    return high
