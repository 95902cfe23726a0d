"""What a reader must know about the rivals, and who wins where, written from what was measured."""

from collections.abc import Iterator

from evaluation.findings import Options, Row
from evaluation.schemes.contenders import DEFAULT_KBIT_PER_S

OURS = "sums, 16 bits"


def notes(measured: list[Row], options: Options) -> list[str]:
    """Return what each contender was given, who wins each touch, and the rule of the event-triggered one."""
    return [*_given(options), *_rules(measured), *_winners(measured), *_latencies(measured)]


def _given(options: Options) -> Iterator[str]:
    yield (
        f"All have four classic buses of 1 Mbit/s and {DEFAULT_KBIT_PER_S:.0f} kbit/s of them in all, what the default "
        "skin takes at 100 Hz; bits, stuff bits and arbitration are exact, heartbeats are in. The image in use is "
        "compared with the truth of the same millisecond, so that what is late counts as wrong."
    )
    yield (
        "PSNR has its peak at 20 mN and is not counted above 71 dB, the rounding of 10 bits. A taxel is wrong while it "
        "is off by more than 4 mN. Latency is from the sample to the end of the frame that brings it."
    )
    yield (
        "Scans are interleaved: a node's frames are spread over the scan and each is sampled when it is called for. "
        "Solved means that the receiver runs the live reconstruction on the complete array, its λ chosen for that. "
        "Coarse arrays are interpolated bilinearly, after solving bicubically."
    )
    yield (
        "Event-triggered taxels are compared every millisecond, ten times as often as ours are sampled. A frame holds "
        "four, the most changed first, with the values of the moment it wins the bus. No node filters its samples."
    )
    yield (
        "Images of sums, and of all that is solved, are in use 1 ms after the last frame. Noise known: the service was "
        "told the sensor's noise (--noise-n)."
    )
    if options.recordings is None:
        yield "Recorded touches are left out: give --recordings FOLDER."
    else:
        yield (
            "A recording is shown ten frames a second; what was recorded, its own noise included, counts as the truth, "
            "which favours whoever sends values as they are."
        )


def chosen_rules(measured: list[Row]) -> list[Row]:
    """Return for every touch and receiver the row of the rule tuned to it, and that of the one rule for all touches."""
    found = []
    for receiver in ("plain", "solved"):
        rules = [row for row in measured if "threshold_n" in row and row["receiver"] == receiver]
        best = one_rule(rules)
        for touch in dict.fromkeys(row["touch"] for row in rules):
            mine = [row for row in rules if row["touch"] == touch]
            fits = [row for row in mine if row["kbit_per_s"] <= DEFAULT_KBIT_PER_S] or mine
            tuned = max(fits, key=lambda row: float(row["psnr_mean_db"]))
            found.append(tuned | {"contender": f"{tuned['contender']} (tuned to this touch)"})
            found += [row | {"contender": f"{best} (for all)"} for row in mine if row["contender"] == best]
    return found


def one_rule(rules: list[Row]) -> str:
    """Return the contender whose rule has the best mean PSNR over all touches, with whatever bits it then takes."""
    quality: dict[str, list[float]] = {}
    for row in rules:
        quality.setdefault(row["contender"], []).append(row["psnr_mean_db"])
    return max(quality, key=lambda name: sum(quality[name]) / len(quality[name]))


def _rules(measured: list[Row]) -> Iterator[str]:
    for receiver in ("plain", "solved"):
        rules = [row for row in measured if "threshold_n" in row and row["receiver"] == receiver]
        mine = [row for row in rules if row["contender"] == one_rule(rules)]
        most, least = (choose(mine, key=lambda row: float(row["kbit_per_s"])) for choose in (max, min))
        yield (
            f"One rule for all touches, the best by mean PSNR: {most['contender']}. It takes {least['kbit_per_s']:.0f} "
            f"kbit/s ({least['touch']}) to {most['kbit_per_s']:.0f} ({most['touch']}); sums take the same at any touch."
        )


def _winners(measured: list[Row]) -> Iterator[str]:
    """Say for each touch who is best by PSNR and by the error of touched taxels, and where our default stands."""
    for touch in dict.fromkeys(row["touch"] for row in measured):
        field = [
            row
            for row in measured
            if row["touch"] == touch and row["share"] == 1.0 and row["kbit_per_s"] <= 1.01 * DEFAULT_KBIT_PER_S
        ]
        ours = next(row for row in field if row["contender"] == OURS)
        best = max(field, key=lambda row: float(row["psnr_mean_db"]))
        line = f"{touch}: best mean PSNR {_stands(best, 'psnr_mean_db', 'dB')}, ours {ours['psnr_mean_db']:.1f} dB"
        if ours["touched_error_mn"] is not None:
            near = min(field, key=lambda row: float(row["touched_error_mn"]))
            line += f"; least error where touched {_stands(near, 'touched_error_mn', 'mN', 2)}"
            line += f", ours {ours['touched_error_mn']:.2f} mN"
        yield line + "."


def _stands(row: Row, key: str, unit: str, digits: int = 1) -> str:
    return f"{row['contender']} ({row['kbit_per_s']:.0f} kbit/s) {row[key]:.{digits}f} {unit}"


def _latencies(measured: list[Row]) -> Iterator[str]:
    """Say how late each gets at worst over all touches: the one rule, ours and the scan."""
    rules = [row for row in measured if "threshold_n" in row and row["receiver"] == "plain"]
    for name in (OURS, "scan, 10 bits", one_rule(rules)):
        mine = [row for row in measured if row["contender"] == name and row["share"] == 1.0]
        worst = max(mine, key=lambda row: float(row["latency_worst_ms"]))
        fullest = max(row["load_peak"] for row in mine)
        yield (
            f"{name}: latest value after {worst['latency_worst_ms']:.1f} ms ({worst['touch']}), fullest 100 ms of a "
            f"bus {fullest:.0%}."
        )
