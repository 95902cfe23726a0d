"""A recording."""

from tests.recording.conftest import contract, force_n, layout_file, out, run, sums

__all__ = ["contract", "force_n", "layout_file", "out", "run", "sums"]
