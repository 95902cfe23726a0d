"""What each contender shows at one instant."""

from collections.abc import Iterator
from functools import cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from evaluation.figure import new_figure
from evaluation.schemes.contenders import Events, Scan, Sums
from evaluation.schemes.judge import Images, Updates
from evaluation.schemes.scenes import SIDE, SLAP_MS, TAXELS
from evaluation.schemes.shown import Contender
from evaluation.schemes.touches import Touch
from evaluation.schemes.wire import TICK_NS
from skin.psnr import psnr_db
from skin.taxel import FORCE_MAX_N
from touch.contact import Force

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SLAP: Final = "three boxes slapped on"
#: Touches, and the instants that are shown, milliseconds from their beginning.
INSTANTS: Final = ((SLAP, SLAP_MS + 15), (SLAP, SLAP_MS + 25), ("faint box", 700))
_SHOWN: Final[tuple[Contender, ...]] = (Sums(16), Scan(64, 10), Scan(32, 10, "solved"), Events(4e-3, 1))
SCALE_MN: Final = 10.0


def caption() -> str:
    """Return what the figure shows; when the first sums of the slap are in use is measured."""
    after = " and ".join(str(tick - SLAP_MS) for name, tick in INSTANTS if name == SLAP)
    return (
        f"What is in use {after} ms after three boxes were slapped on, and while a faint box slides, with the PSNR of "
        f"each image. The sums' first image of the slap is in use {first_after_slap_ms():.1f} ms after it began. 0 to "
        f"{SCALE_MN:g} mN."
    )


@cache
def first_after_slap_ms() -> float:
    """Return how long after the slap began the default skin's first image that has seen it is in use."""
    images = _SHOWN[0].show(Touch(SLAP), 1.0).images
    if not isinstance(images, Images):
        raise TypeError("sums are always solved to whole images")
    seen = images.ready_ns > SLAP_MS * TICK_NS
    touched = images.force_n.max(axis=1) > FORCE_MAX_N / 10
    return float(images.ready_ns[seen & touched][0]) / TICK_NS - SLAP_MS


def images_figure() -> "Figure":
    """Draw truth and contenders side by side."""
    figure = new_figure(12, 2.7 * len(INSTANTS))
    panels = figure.subplots(len(INSTANTS), 1 + len(_SHOWN), squeeze=False)
    for row, (name, tick) in zip(panels, INSTANTS, strict=True):
        true = Touch(name).load().true_n[tick]
        _draw(row[0], f"{name},\n{tick} ms: truth", true)
        for panel, (title, image) in zip(row[1:], _shown(name, tick), strict=True):
            level = psnr_db(true, image, FORCE_MAX_N)
            drawn = _draw(panel, f"{title}\n{level:.1f} dB", image)
    figure.colorbar(drawn, ax=panels, label="mN", shrink=0.7)
    return figure


def _draw(panel: Any, title: str, force_n: Force) -> Any:
    panel.set_title(title, fontsize="small")
    panel.set_axis_off()
    return panel.imshow(1e3 * force_n.reshape(SIDE, SIDE), vmin=0, vmax=SCALE_MN, cmap="viridis")


def _shown(name: str, tick: int) -> Iterator[tuple[str, Force]]:
    """Yield the name of each contender, and what it has in use at `tick`, newtons, shape (TAXELS,)."""
    for contender in _SHOWN:
        yield contender.name, _at(contender.show(Touch(name), 1.0).images, tick)


def _at(shown: Images | Updates, tick: int) -> Force:
    now_ns: npt.NDArray[np.int64] = np.array([tick * TICK_NS])
    images = shown.held(now_ns, TAXELS) if isinstance(shown, Updates) else shown
    used = int(np.searchsorted(images.ready_ns, now_ns[0], side="right")) - 1
    force_n: Force = images.force_n[used] if used >= 0 else np.zeros(TAXELS, np.float32)
    return force_n
