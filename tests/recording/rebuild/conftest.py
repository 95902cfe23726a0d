"""The small skin of the recordings."""

from tests.recording.conftest import contract, force_n, layout_file, sums

__all__ = ["contract", "force_n", "layout_file", "sums"]
