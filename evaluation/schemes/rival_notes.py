"""What a reader must know about the rivals, and who wins where, written from what was measured."""

from collections.abc import Iterator
from typing import Final

from evaluation.findings import Options, Row
from evaluation.schemes.contenders import Scan, Sums
from evaluation.schemes.default_skin import default_kbit_per_s
from evaluation.schemes.judge import PSNR_MOST_DB, WRONG_N
from evaluation.schemes.scenes import RECORDED_MS
from evaluation.schemes.sums import SOLVED_NS
from skin.layout import load_layout
from skin.taxel import FORCE_MAX_N

#: The default skin, and the plainest of its rivals.
OURS: Final = Sums(16)
FULL_SCAN: Final = Scan(64, 10)
#: Who sends by the clock keeps the bits that far: only whole scans are sent.
_BITS_TOLERANCE: Final = 1.01


def notes(measured: list[Row], options: Options) -> list[str]:
    """Return what each contender was given, who wins each touch, and the rule of the event-triggered one."""
    return [
        *_given(),
        *_receivers(measured),
        *_recordings(options),
        *_rules(measured),
        *_winners(measured),
        *_latencies(measured),
    ]


def _given() -> Iterator[str]:
    yield (
        f"All have four classic buses of 1 Mbit/s and {default_kbit_per_s():.0f} kbit/s of them in all, what the "
        f"default skin takes at {load_layout().sync.rate_hz:g} Hz; bits, stuff bits and arbitration are exact, "
        "heartbeats are in. The image in use is compared with the truth of the same millisecond, so that what is late "
        "counts as wrong."
    )
    yield (
        f"PSNR has its peak at {1e3 * FORCE_MAX_N:g} mN and is not counted above {PSNR_MOST_DB:g} dB, the rounding of "
        f"10 bits. A taxel is wrong while it is off by more than {1e3 * WRONG_N:g} mN. Latency is from the sample to "
        "the end of the frame that brings it."
    )
    yield (
        "Scans are interleaved: a node's frames are spread over the scan and each is sampled when it is called for. "
        "Coarse arrays are interpolated bilinearly, after solving bicubically."
    )
    yield (
        "Event-triggered taxels are compared every millisecond, ten times as often as the default skin's are sampled. "
        "A frame holds four, the most changed first, with the values of the moment it wins the bus. No node filters "
        "its samples."
    )


def _receivers(measured: list[Row]) -> Iterator[str]:
    yield (
        f"Images of sums, and of all that is solved, are in use {SOLVED_NS * 1e-6:g} ms after the last frame: an "
        "assumption for gateway, fabric and solver, from the running chain. Values that are shown as they come are in "
        "use as soon as their frame ended: rivals that are not solved are given a receiver that takes no time."
    )
    yield "Solved means that the receiver runs the live reconstruction on the complete array, its λ chosen for that."
    if any(row["receiver"] == "noise known" for row in measured):
        yield "Noise known: the service was told the sensor's noise (--noise-n)."


def _recordings(options: Options) -> Iterator[str]:
    if options.recordings is None:
        yield "Recorded touches are left out: give --recordings FOLDER."
    else:
        yield (
            f"A recording is shown with {1000 / RECORDED_MS:g} frames a second; what was recorded, its own noise "
            "included, counts as the truth, which favours whoever sends values as they are."
        )


def chosen_rules(measured: list[Row]) -> list[Row]:
    """Return for every touch and receiver the row of the rule tuned to it, and that of the one rule for all touches.

    Parameters
    ----------
    measured : list of dict
        Rows of `evaluation.schemes.rivals`, those of event-triggered taxels among them.

    Returns
    -------
    list of dict
        With ``rule``: ``tuned to this touch`` or ``one for all``.
    """
    found = []
    for receiver in ("plain", "solved"):
        rules = _events(measured, receiver)
        best = one_rule(rules)
        for touch in dict.fromkeys(row["touch"] for row in rules):
            mine = [row for row in rules if row["touch"] == touch]
            fits = [row for row in mine if row["kbit_per_s"] <= default_kbit_per_s()] or mine
            found.append(max(fits, key=lambda row: float(row["psnr_mean_db"])) | {"rule": "tuned to this touch"})
            found += [row | {"rule": "one for all"} for row in mine if row["name"] == best]
    return found


def one_rule(rules: list[Row]) -> str:
    """Return the contender whose rule has the best mean PSNR over all touches, with whatever bits it then takes."""
    quality: dict[str, list[float]] = {}
    for row in rules:
        quality.setdefault(row["name"], []).append(row["psnr_mean_db"])
    return max(quality, key=lambda name: sum(quality[name]) / len(quality[name]))


def _events(measured: list[Row], receiver: str) -> list[Row]:
    return [row for row in measured if row["family"] == "events" and row["receiver"] == receiver]


def _rules(measured: list[Row]) -> Iterator[str]:
    ours = [row["kbit_per_s"] for row in measured if row["contender"] == OURS and row["share"] == 1.0]
    for receiver in ("plain", "solved"):
        rules = _events(measured, receiver)
        mine = [row for row in rules if row["name"] == one_rule(rules)]
        most, least = (choose(mine, key=lambda row: float(row["kbit_per_s"])) for choose in (max, min))
        yield (
            f"One rule for all touches, the best by mean PSNR: {most['name']}. It takes {least['kbit_per_s']:.0f} "
            f"kbit/s ({least['touch'].words}) to {most['kbit_per_s']:.0f} ({most['touch'].words}); {OURS.name} take "
            f"{min(ours):.0f} to {max(ours):.0f}."
        )


def _winners(measured: list[Row]) -> Iterator[str]:
    """Say for each touch who is best by PSNR and by the error of touched taxels, and where our default stands."""
    most_kbit_per_s = _BITS_TOLERANCE * default_kbit_per_s()
    for touch in dict.fromkeys(row["touch"] for row in measured):
        here = [row for row in measured if row["touch"] == touch and row["share"] == 1.0]
        field = [row for row in here if row["kbit_per_s"] <= most_kbit_per_s]
        ours = next(row for row in here if row["contender"] == OURS)
        best = max(field, key=lambda row: float(row["psnr_mean_db"]))
        line = f"{touch.words}: best mean PSNR {_stands(best, 'psnr_mean_db', 'dB')}, ours {ours['psnr_mean_db']:.1f}"
        line += " dB"
        if ours["touched_error_mn"] is not None:
            near = min(field, key=lambda row: float(row["touched_error_mn"]))
            line += f"; least error where touched {_stands(near, 'touched_error_mn', 'mN', 2)}"
            line += f", ours {ours['touched_error_mn']:.2f} mN"
        yield line + "."


def _stands(row: Row, key: str, unit: str, digits: int = 1) -> str:
    return f"{row['name']} ({row['kbit_per_s']:.0f} kbit/s) {row[key]:.{digits}f} {unit}"


def _latencies(measured: list[Row]) -> Iterator[str]:
    """Say how late each gets at worst over all touches: the one rule, ours and the scan."""
    for name in (OURS.name, FULL_SCAN.name, one_rule(_events(measured, "plain"))):
        mine = [row for row in measured if row["name"] == name and row["share"] == 1.0]
        worst = max(mine, key=lambda row: float(row["latency_worst_ms"]))
        fullest = max(row["load_peak"] for row in mine)
        yield (
            f"{name}: latest value after {worst['latency_worst_ms']:.1f} ms ({worst['touch'].words}), fullest 100 ms "
            f"of a bus {fullest:.0%}."
        )
