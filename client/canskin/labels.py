"""Whether a label is based on enough sums."""

from typing import Final

from canskin.messages import Label

#: A label from less than this part of the skin's sums is void; it does not mean that there is no contact.
MIN_VALID_RATIO: Final = 0.25


def is_measured(label: Label, sums: int) -> bool:
    """Tell whether a label of a skin with `sums` sums is based on enough sums.

    The empty label of a dead skin does not mean "no contact".
    """
    return not label.blind and label.valid_sums >= MIN_VALID_RATIO * (label.sums or sums)
