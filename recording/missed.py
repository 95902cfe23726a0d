"""Messages that the fabric dropped on their way to the recorder, by the gaps in their numbers."""

from collections import Counter

from canskin.fabric import Origin


class Missed:
    """Counts the messages that did not come, between the first and the newest of each publisher and topic."""

    def __init__(self) -> None:
        self._expected: dict[tuple[str, str], int] = {}
        self._counts: Counter[str] = Counter()

    def take(self, topic: str, origin: Origin) -> None:
        """Take note of a message."""
        key = topic, origin.publisher
        expected = self._expected.get(key, origin.number)
        # A number below the expected one was counted as missed, and came after its successor.
        self._counts[topic] += origin.number - expected if origin.number >= expected else -1
        self._expected[key] = max(expected, origin.number + 1)

    def counts(self) -> dict[str, int]:
        """Return the numbers of messages that did not come, by topic, without those that all came."""
        return {topic: count for topic, count in sorted(self._counts.copy().items()) if count > 0}
