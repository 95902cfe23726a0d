"""What the paper says about recognising objects: training sizes, accuracies and confusions (section VI-B)."""

from typing import Final

#: Development and validation set as parts of the perturbations. The paper lists five validation ratios for its six
#: development ratios; its text fits half of each development ratio.
TRAINING: Final = ((0.4, 0.2), (0.2, 0.1), (0.1, 0.05), (0.06, 0.03), (0.02, 0.01), (0.0066, 0.0033))
FULL, THREE_PERCENT, ONE_PERCENT = TRAINING[0], TRAINING[4], TRAINING[5]
#: Sums of the confusion matrices.
CONFUSION_SIZE: Final = 64
#: Accuracies of the text, percent, by (signal, size, training set). Its curves have no numbers.
ACCURACIES: Final = {
    ("sbhe", 64, FULL): 98.0,
    ("sbhe", 16, FULL): 93.2,
    ("noiselet", 16, FULL): 93.4,
    ("averaged", 64, FULL): 93.3,
    ("averaged", 16, FULL): 60.0,
    ("sbhe", 16, THREE_PERCENT): 80.0,
    ("sbhe", 16, ONE_PERCENT): 70.0,
    ("noiselet", 16, ONE_PERCENT): 70.0,
}
#: Confusions the text names, (true, said): percent where it gives a number.
CONFUSIONS: Final = {
    ("volleyball", "basketball"): 25.0,
    ("basketball", "volleyball"): 25.0,
    ("gravy-can", "volleyball"): None,
    ("mustard-upright", "racquetball"): None,
    ("cereal-box", "cracker-box"): None,
    ("cereal-box", "mustard-lying"): None,
    ("jello-box", "basketball"): None,
}
