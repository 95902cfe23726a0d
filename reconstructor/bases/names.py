"""Names of orthonormal wavelet bases: a wavelet of PyWavelets, in the form of a pyramid or of the paper's tensor."""

import difflib
import re
from functools import cache
from typing import TYPE_CHECKING, Final

import numpy as np

from canskin.errors import InputError

if TYPE_CHECKING:
    import pywt

#: A wavelet without a form means the first.
FORMS: Final = ("pyramid", "tensor")
#: The paper's wavelets, by the names of this project and by those of PyWavelets; D4 has four taps.
_OURS: Final = {"haar": "haar", "d4": "db2"}
_CANONICAL: Final = {"db1": "haar", "db2": "d4"}
#: Largest error of the orthogonality of a filter. PyWavelets calls dmey orthogonal; its error is 2e-3.
_EXACT: Final = 1e-9


def wavelet_basis_name(name: str) -> str:
    """Return the full name of a basis: ``sym4`` and ``sym4-pyramid`` give ``sym4-pyramid``, ``db2`` ``d4-pyramid``.

    Raise InputError unless PyWavelets has the wavelet; the message has the nearest name and lists the families.
    """
    wavelet, dash, form = name.rpartition("-")
    if not dash:
        wavelet, form = name, FORMS[0]
    wavelet = _CANONICAL.get(wavelet, wavelet)
    if form not in FORMS or (wavelet not in _OURS and wavelet not in orthogonal_wavelets()):
        import pywt

        is_other = form in FORMS and wavelet in pywt.wavelist()
        what = f"'{name}' is not orthogonal" if is_other else f"unknown basis '{name}'"
        raise InputError(f"{what}: {_expected(name)}")
    return f"{wavelet}-{form}"


def wavelet_of(name: str) -> "tuple[pywt.Wavelet, str]":
    """Return wavelet and form of a full name; raises as `wavelet_basis_name`."""
    import pywt

    wavelet, _, form = wavelet_basis_name(name).rpartition("-")
    return pywt.Wavelet(_OURS.get(wavelet, wavelet)), form


@cache
def orthogonal_wavelets() -> tuple[str, ...]:
    """Return the names of the wavelets of PyWavelets that are orthogonal to 1e-9: not dmey."""
    import pywt

    return tuple(name for name in pywt.wavelist(kind="discrete") if _is_orthogonal(pywt.Wavelet(name)))


def _is_orthogonal(wavelet: "pywt.Wavelet") -> bool:
    if not wavelet.orthogonal:
        return False
    taps = np.array(wavelet.rec_lo)
    shifted = np.correlate(taps, taps, "full")[(taps.size - 1) % 2 :: 2]  # Σ h[i] h[i + 2k] for all k
    return bool(np.abs(shifted - (np.arange(shifted.size) == shifted.size // 2)).max() < _EXACT)


def _expected(name: str) -> str:
    """Return the nearest name, and all names by family."""
    known = (*_OURS, *orthogonal_wavelets())
    near = difflib.get_close_matches(name.partition("-")[0].lower(), known, 1)
    families: dict[str, list[int]] = {}
    for each in orthogonal_wavelets():
        family, order = re.fullmatch(r"([a-z]+)(\d*)", each).groups()  # type: ignore[union-attr]  # all fit
        families.setdefault(family, []).extend([int(order)] if order else [])
    listed = [
        f"{family}{min(orders)} to {family}{max(orders)}" if orders else family for family, orders in families.items()
    ]
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"{hint}expected an orthogonal wavelet, {', '.join(listed)} or d4, alone or with -pyramid or -tensor"
