"""Numbers of adaptive boards as C: ``adaptive.h`` and ``adaptive.c``, the same for all boards of a skin.

The codes come as tables, so a board needs neither asinh nor sinh: the sum at which each code begins, to the last bit,
and the value of each code.
"""

from collections.abc import Iterable
from typing import Final

import numpy as np

from dbc.adaptive import (
    BLOCK_SUMS,
    CRC_8,
    FINE_BITS,
    FINE_LEVELS,
    FINE_LIMIT,
    FINE_REACH,
    GROUP_SUMS,
    KINDS,
    LEVELS,
    LOST_NS,
    MEAN_CODES,
    NO_CHECK,
    OTHER_CODES,
    PAUSE_MS,
    SAVED_FRAMES,
    SAVING_S,
    Companding,
    SendingRule,
    coarse_code,
    coarse_value,
)
from dbc.adaptive_filter import (
    AVERAGES,
    FOLLOWING,
    GIVEN_NOISE_N,
    HIGHEST_N,
    HORIZON,
    IDLE_PART,
    IDLE_RATIOS,
    IDLE_SAMPLES,
    LEAST_NOISE_N,
    LEAST_PART,
    LOG2_SERIES,
    LOWEST_RATIO,
    QUIET_RATIO,
    RATE_N,
    RETURN_N,
    RISE_N,
    ROOT_HALF,
    SAMPLE_NS,
    SETTLING_SAMPLES,
    SPANS,
    SWITCHING,
    TRENDS,
    UNCLIP_POINTS,
    UNCLIP_REACH,
    WINDOW,
    make_models,
    unclip_table,
)
from dbc.contract import Contract
from firmware.c_text import WRITTEN, array, defined, double, header, real
from skin.clipping import DEAD_RATIO
from skin.walsh import GROUPS, grouped_rows, haar_matrix, patch_shape, walsh_matrix

_MODELS: Final = len(AVERAGES) + len(TRENDS)


def adaptive_header(contract: Contract) -> str:
    """Return ``adaptive.h``: the numbers of codes, filter and sending."""
    law, count_n = contract.law, contract.layout.taxels.newton_per_count
    reals = sum(1 << place for place, value in enumerate(SendingRule(), 1) if isinstance(value, float))
    high, wide = patch_shape(BLOCK_SUMS)
    values: dict[str, tuple[object, str]] = {
        "SKIN_PATCH_HIGH": (high, "taxels of a board"),
        "SKIN_PATCH_WIDE": (wide, "side by side"),
        "SKIN_PATCH_SUMS": (
            BLOCK_SUMS,
            "all, row by row, and as many sums in the order of the frames",
        ),
        "SKIN_GROUPS": (GROUPS, "of these sums"),
        "SKIN_GROUP_SUMS": (GROUP_SUMS, "of a group"),
        "SKIN_LEVELS": (LEVELS, "of urgency, of coarse frames"),
        "SKIN_FINE_LEVELS": (FINE_LEVELS, "of fine frames"),
        "SKIN_KINDS": (KINDS, "and of both"),
        "SKIN_MEAN_CODES": (MEAN_CODES, "highest code of the first sum"),
        "SKIN_OTHER_CODES": (OTHER_CODES, "codes on each side of 0 of the others"),
        "SKIN_FINE_BITS": (FINE_BITS, "of a sum in a fine frame"),
        "SKIN_FINE_REACH": (FINE_REACH, "fine steps that these bits tell on each side"),
        "SKIN_FINE_LIMIT": (FINE_LIMIT, "most fine steps from the coarse value that a frame is made for"),
        "SKIN_CRC_8": (f"0x{CRC_8:X}u", "polynomial of the check"),
        "SKIN_NO_CHECK": (f"({NO_CHECK})", "in place of a check: no coarse frame was sent"),
        "SKIN_RULE_ENTRIES": (len(SendingRule()), "of 2031h"),
        "SKIN_NEWTON_PER_COUNT": (double(count_n), "of a taxel"),
        "SKIN_MEAN_SLOPE": (double(law.mean_slope), "2007h"),
        "SKIN_MEAN_KNEE_N": (double(law.mean_knee_n), "2007h"),
        "SKIN_SLOPE": (double(law.slope), "2007h"),
        "SKIN_KNEE_N": (double(law.knee_n), "2007h"),
        "SKIN_FINE_N": (double(law.fine_n), "2007h"),
        "SKIN_RULE_REALS": (f"0x{reals:04X}u", "sub-indices of 2031h that are REAL32, a bit each"),
        "SKIN_SAMPLE_NS": (SAMPLE_NS, "time between two samples"),
        "SKIN_LOST_SAMPLES": (LOST_NS // SAMPLE_NS, "a frame that was neither sent nor given up for so long is lost"),
        "SKIN_PAUSE_NS": (PAUSE_MS * 1_000_000, "no sums start so soon after a SYNC"),
        "SKIN_SAVED_FRAMES": (SAVED_FRAMES, "frames that a budget may save up at least"),
        "SKIN_SAVING_S": (double(SAVING_S), "time for which a budget may be saved up"),
        "SKIN_IDLE_SAMPLES": (IDLE_SAMPLES, "samples from which the noise is learned"),
        "SKIN_SETTLING_SAMPLES": (SETTLING_SAMPLES, "samples that the filter has then seen"),
        "SKIN_SPANS": (len(SPANS), "lengths of the means in which noise is looked at"),
        "SKIN_SPAN_SAMPLES": ("{" + ", ".join(map(str, SPANS)) + "}", "these lengths"),
        "SKIN_LEAST_GIVEN_N": (real(GIVEN_NOISE_N[0]), "least noise that may be given, besides 0"),
        "SKIN_MOST_GIVEN_N": (real(GIVEN_NOISE_N[1]), "and most"),
        "SKIN_LEAST_NOISE_N": (double(LEAST_NOISE_N), "least noise"),
        "SKIN_FILTERS": (_MODELS, "models that run side by side"),
        "SKIN_AVERAGES": (len(AVERAGES), "the first of them: averages, which have no slope"),
        "SKIN_CHANGE": (real(SWITCHING / (_MODELS - 1)), "chance of a change to a model"),
        "SKIN_STAY": (real(1.0 - SWITCHING), "chance of no change"),
        "SKIN_HORIZON": (real(HORIZON), "samples that a forecast looks ahead"),
        "SKIN_LOG2": ("{" + ", ".join(map(double, LOG2_SERIES)) + "}", "series of the logarithm of urgency"),
        "SKIN_LEAST_PART": (double(LEAST_PART), "of the number whose logarithm the series tells"),
        "SKIN_ROOT_HALF": (real(ROOT_HALF), "square root of 1/2"),
        "SKIN_UNCLIP_POINTS": (UNCLIP_POINTS, "of the table that undoes clipping"),
        "SKIN_UNCLIP_SCALE": (real((UNCLIP_POINTS - 1) / UNCLIP_REACH), "points per standard deviation"),
        "SKIN_DEAD_RATIO": (real(DEAD_RATIO), "of the noise: forces below are 0"),
        "SKIN_FOLLOWING": (real(FOLLOWING), "part of what is left that an offset follows"),
        "SKIN_RATE_N": (real(RATE_N), "most that it falls in a sample"),
        "SKIN_RETURN_N": (real(RETURN_N), "most that it rises below that of power-up"),
        "SKIN_RISE_N": (real(RISE_N), "most that it rises above"),
        "SKIN_HIGHEST_N": (real(HIGHEST_N), "no offset is so much above that of power-up"),
        "SKIN_QUIET_RATIO": (real(QUIET_RATIO), "of the noise: a taxel is quiet below"),
        "SKIN_LOWEST_RATIO": (real(LOWEST_RATIO), "of the noise: no offset falls below"),
        "SKIN_WINDOW": (WINDOW, "samples over which the size of the noise is looked at"),
        "SKIN_IDLE_LOW": (real(IDLE_RATIOS[0]), "mean over deviation of an idle taxel, least"),
        "SKIN_IDLE_HIGH": (real(IDLE_RATIOS[1]), "and most"),
        "SKIN_IDLE_PART": (real(IDLE_PART), "part of the taxels that have to be idle"),
    }
    return header(
        "ADAPTIVE_H",
        f"Numbers of adaptive boards of the skin {contract.layout.name}.",
        ["#include <stdint.h>", "", '#include "contract.h"', "", *defined(values)],
    )


def adaptive_source(contract: Contract) -> str:
    """Return ``adaptive.c``: the tables of codes and filter."""
    law, models = contract.law, make_models(HORIZON)
    first, size = _bands()
    reals = {
        "skin_gain": models.gain,
        "skin_slope_gain": models.slope_gain,
        "skin_half_precision": models.half_precision,
        "skin_log_spread": models.log_spread,
        "skin_forecast_variance": models.variance,
        "skin_unclip": unclip_table(),
    }
    doubles: dict[str, Iterable[float]] = {
        "skin_mean_least": (_least(code, is_mean=True, law=law) for code in range(1, MEAN_CODES + 1)),
        "skin_mean_value": (coarse_value(code, True, law) for code in range(MEAN_CODES + 1)),
        "skin_other_least": (_least(code, is_mean=False, law=law) for code in range(1, OTHER_CODES + 1)),
        "skin_other_value": (coarse_value(OTHER_CODES + 1 + code, False, law) for code in range(OTHER_CODES + 1)),
    }
    bytes_: dict[str, Iterable[int]] = {
        "skin_row_of_sum": grouped_rows(BLOCK_SUMS).ravel().tolist(),
        "skin_band_of_sum": first,
        "skin_band_size": size,
    }
    lines = [
        *(line for name, each in reals.items() for line in array("const float", name, map(real, each), per_line=6)),
        *(
            line
            for name, each in doubles.items()
            for line in array("const double", name, map(double, each), per_line=4)
        ),
        *(line for name, each in bytes_.items() for line in array("const uint8_t", name, each)),
    ]
    comment = f"/* Tables of adaptive boards of the skin {contract.layout.name}. {WRITTEN} */"
    return "\n".join([comment, '#include "skin_filter.h"', "", *lines, ""])


def _bands() -> tuple[list[int], list[int]]:
    """Return the first Haar coefficient, and the number of coefficients, that a sum's variance comes from."""
    share = np.rint(np.square(haar_matrix(BLOCK_SUMS) @ walsh_matrix(BLOCK_SUMS).T)) > 0
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
