"""The messages of the small skin of the viewer's tests, a hub, and a recording."""

from tests.recording.conftest import contract, force_n, layout_file, out, run, sums
from tests.views.page.conftest import hub, messages

__all__ = ["contract", "force_n", "hub", "layout_file", "messages", "out", "run", "sums"]
