"""``skin evaluate claims``: every claim of the paper's abstract and conclusion, and what is measured here."""

from typing import Final, Literal, NamedTuple

from evaluation.bench.claimed import claimed as processing
from evaluation.paper.claimed import claimed as images
from evaluation.printed import paper_value
from evaluation.recognition.claimed import claimed as recognition
from evaluation.result import Finding, Options, Result, Row, beside
from evaluation.schemes.claimed import claimed as hardware


class Claim(NamedTuple):
    """A row of the table: the claim in short words, the quantity, the name of its figure, a command that shows more."""

    words: str
    quantity: str
    figure: str
    command: str
    mode: Literal["offline", "live"] = "offline"


#: Functions of the options that make figures, by name.
MAKERS: Final = (images, hardware, recognition, processing)
AS_GOOD: Final = "1024 sums are as good as all 4096 taxels"
QUARTER: Final = "a quality signal from a fourth of its size"
FAST: Final = "4096 taxels at over 100 Hz"
LESS: Final = "less data is sent, faster acquisition"
BEST: Final = "up to 98 % accuracy at 64:1"
LITTLE: Final = "high accuracy with much compression and little training"
SAME: Final = "better than sensor signals of the same size"
HARDWARE: Final = "compressed in hardware before transmission"
WIRES: Final = "less wiring"
_GAIN: Final = "PSNR of images - PSNR of sensor"
_ACCURACY: Final = "accuracy, 16 objects"
_HELD: Final = "cycles of a full press with the right label, 16 objects, our shapes"
_CONVERTER: Final = "PSNR with a 10-bit converter for each sum - for each taxel"
_TABLES: Final = "skin evaluate compression"
_TIMES: Final = "skin evaluate iterations"
_RIVALS: Final = "skin evaluate rivals"
_NAMES: Final = "skin evaluate classification"
_LIVE_NAMES: Final = "skin evaluate recognition"
_FRONT_ENDS: Final = "skin evaluate frontend"
_CHAINS: Final = "skin evaluate wiring"

CLAIMS: Final = (
    Claim(AS_GOOD, f"{_GAIN}, haar, mean of 5 objects, dB", "gain haar", _TABLES),
    Claim(AS_GOOD, f"{_GAIN}, haar, worst object, dB", "least gain haar", _TABLES),
    Claim(AS_GOOD, f"{_GAIN}, contourlet, mean of 5 objects, dB", "gain contourlet", _TABLES),
    Claim(AS_GOOD, f"{_GAIN}, contourlet, worst object, dB", "least gain contourlet", _TABLES),
    Claim(AS_GOOD, f"{_GAIN}, 5 objects, dB", "live gain", _RIVALS, "live"),
    Claim(QUARTER, "PSNR of images, haar, dB", "PSNR haar", _TABLES),
    Claim(QUARTER, "PSNR of images, contourlet, dB", "PSNR contourlet", _TABLES),
    Claim(
        "full signal recovered when needed",
        "PSNR of a single image from zero, contourlet, 100 iterations, clamp, dB",
        "from zero",
        "skin evaluate figures",
    ),
    Claim(FAST, "images a second, haar, 20 iterations", "rate haar", _TIMES),
    Claim(FAST, "images a second, contourlet, 20 iterations", "rate contourlet", _TIMES),
    Claim(FAST, "complete cycles a second, simulated buses", "complete cycles", "skin plan", "live"),
    Claim(FAST, "cycles a second that four buses of 1 Mbit/s carry", "carried cycles", "skin plan"),
    Claim(LESS, "taxels / sums", "compression", _RIVALS),
    Claim(LESS, "bits on the bus: scan of all taxels, 10 bits / sums", "bits", _RIVALS, "live"),
    Claim(
        LESS,
        "cycles of 64 sums a second that one bus of 1 Mbit/s carries",
        "carried cycles of 64",
        "skin plan recognition",
    ),
    Claim(BEST, f"{_ACCURACY}, 64 sums, 60 % training, %", "64 sums", _NAMES),
    Claim(BEST, f"{_HELD}, 64 sums, %", "live, 64 sums", _LIVE_NAMES, "live"),
    Claim(LITTLE, f"{_ACCURACY}, 16 sums, 60 % training, %", "16 sums", _NAMES),
    Claim(LITTLE, f"{_ACCURACY}, 16 sums, 3 % training, %", "16 sums, 3 %", _NAMES),
    Claim(LITTLE, f"{_ACCURACY}, 16 sums, 1 % training, %", "16 sums, 1 %", _NAMES),
    Claim(LITTLE, f"{_HELD}, 16 sums, %", "live, 16 sums", _LIVE_NAMES, "live"),
    Claim(
        "accuracy as on the original signal",
        "accuracy of 64 sums - accuracy of all 4096 taxels, points",
        "64 sums - all taxels",
        _NAMES,
    ),
    Claim(SAME, "accuracy of 64 sums - accuracy of 64 coarse taxels, points", "64 sums - 64 taxels", _NAMES),
    Claim(SAME, "accuracy of 16 sums - accuracy of 16 coarse taxels, points", "16 sums - 16 taxels", _NAMES),
    Claim(HARDWARE, f"{_CONVERTER}, same λ, 5 objects, dB", "analogue, same λ", _FRONT_ENDS),
    Claim(HARDWARE, f"{_CONVERTER}, λ that fits the noise of each, 5 objects, dB", "analogue", _FRONT_ENDS),
    Claim(HARDWARE, "conversions in a cycle, for each taxel / for each sum", "conversions", _FRONT_ENDS),
    Claim(WIRES, "taxels / chains of taxels", "chains", _CHAINS),
    Claim(
        WIRES,
        "length of a wire to each taxel from the middle of its block / length of the chains",
        "star",
        _CHAINS,
    ),
    Claim("less processing", "time of a decision: 4096 taxels / 64 sums", "decision", "skin bench classify"),
)


def evaluate(options: Options) -> Result:
    """Return a row for each claim and quantity."""
    made: dict[str, Finding] = {}
    for maker in MAKERS:
        made |= maker(options)
    rows: list[Row] = []
    for claim in CLAIMS:
        figure = made[claim.figure]
        printed = paper_value("claims", quantity=claim.quantity) if figure.paper is None else figure.paper
        numbers = beside(float(figure.ours), None if printed is None else round(float(printed), 2))
        numbers |= {"spread": None if figure.spread is None else round(float(figure.spread), 2)}
        about = {"mode": claim.mode, "runs": figure.runs, "command": claim.command}
        rows.append({"claim": claim.words, "quantity": claim.quantity} | numbers | about)
    note = (
        "paper: the number of the text, or of the table on which the claim rests, its over 80 % and under 60 % as 80 "
        "and 60; empty where the paper has none. "
        "spread: standard deviation over draws and splits. "
        "offline: arrays, or arithmetic. live: the code of boards, frames, solver and classifier of the running skin, "
        "in one process; those of the default skin also on simulated buses. runs: trajectories, splits, cycles, "
        "images, touches or decisions behind the figure. Sensor: one raw sample. Live images have our solver, "
        "and averages on the boards. "
        "Live labels are made as in the paper: its sixteen objects, drawn sums as features, one sample of a taxel in "
        "a cycle; their touches have our shapes, with meshes too. skin demo shows the images in real time, and with "
        "--objects paper --stroke press --layout recognition the sixteen, named from 64 rows that training chose."
    )
    return Result("Claims of the paper's abstract and conclusion", rows, note=note)
