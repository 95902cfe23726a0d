"""What `bandwidth.quality` predicts of a run, beside the images that came, and why the two differ."""

from typing import Final

import msgspec

from bandwidth.quality import TOUCHES_S, is_quick, quality
from canskin.errors import RunError
from demo.options import DemoOptions
from demo.report import WORDS, Report
from skin.layout import Layout

#: A prediction that is this near needs no words, decibels.
WITHIN_DB: Final = 1.0
#: Least part of complete cycles that explains nothing.
WHOLE_RATIO: Final = 0.99


def with_prediction(report: Report, layout: Layout, options: DemoOptions, live_db: float | None) -> Report:
    """Return the figures of a run with the predicted PSNR of its first touches.

    As it is without contact, and for recordings and layouts whose prediction takes long.

    Parameters
    ----------
    layout : Layout
        As it was given; the run may have had a lower rate.
    live_db : float or None
        PSNR of the images over the first `TOUCHES_S`.
    """
    touch, seconds = options.touch, min(options.seconds, TOUCHES_S)
    if live_db is None or touch.input is not None or not is_quick(layout):
        return report
    try:
        predicted_db = quality(layout, touches_s=seconds, source=touch.source(layout)).psnr_image_db
    except RunError:  # nothing touches so early
        return report
    return msgspec.structs.replace(
        report,
        psnr_predicted_db=round(predicted_db, 2),
        psnr_first_db=round(live_db, 2),
        why_not_predicted=_causes(report, layout, options) if abs(predicted_db - live_db) > WITHIN_DB else "",
    )


def _causes(report: Report, layout: Layout, options: DemoOptions) -> str:
    """Say in what a run differed from its prediction."""
    causes = []
    if layout.sends.in_cycles and report.sync_rate_hz < WHOLE_RATIO * layout.sync.rate_hz:
        causes.append(f"{report.sync_rate_hz:.1f} of {layout.sync.rate_hz:g} Hz were kept")
    if report.cycles_complete < WHOLE_RATIO * report.cycles:
        lost = report.cycles - report.cycles_complete
        causes.append(f"{lost} of {report.cycles} cycles were incomplete")
    if options.touch.defect or options.touch.drift:
        causes.append("the taxels had defects")
    if options.solver is not None:
        causes.append("another solver was chosen")
    if not layout.is_of_one_instant:
        causes.append(f"{WORDS[report.sending].latency} took {report.latency_ms.p50 or 0:.0f} ms")
    return "; ".join(causes) or "no known cause"
