"""When a label tells what the skin feels, and when it does not."""

from typing import Final

from skin.messages import Label

#: With fewer sums than this part of the skin's, a label says nothing, least of all that nothing touches.
MIN_VALID_RATIO: Final = 0.25


def is_measured(label: Label, sums: int) -> bool:
    """Tell whether enough of a skin of `sums` sums was measured for its label to count.

    An empty label of a dead skin must never be read as "no contact".
    """
    return not label.blind and label.valid_sums >= MIN_VALID_RATIO * sums
