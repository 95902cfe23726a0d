"""Storage of waiting frames: slots of one growing array, so a burst is stored and gathered in one operation."""

from collections.abc import Sequence

from dbc.frame import Frames, frames


class FramePool:
    """Slots for frames: `store` returns slot numbers, `take` returns the frames and frees the slots."""

    def __init__(self, size: int = 256) -> None:
        self.slots: Frames = frames(size)
        self._free = list(range(size))

    def store(self, burst: Frames) -> list[int]:
        """Copy `burst` into free slots and return their numbers, in order."""
        count = len(burst)
        while count > len(self._free):
            size = len(self.slots)
            grown = frames(2 * size)
            grown[:size] = self.slots
            self.slots = grown
            self._free.extend(range(size, 2 * size))
        taken = self._free[len(self._free) - count :]
        del self._free[len(self._free) - count :]
        self.slots[taken] = burst
        return taken

    def take(self, numbers: Sequence[int]) -> Frames:
        """Return a copy of the frames in these slots, and free them."""
        gathered: Frames = self.slots[list(numbers)]
        self._free.extend(numbers)
        return gathered
