"""Tests on a real CAN kernel. `tests/vcan/run` gives them one; any other run leaves them out and says so."""

import os
from typing import Final

import pytest

GIVEN: Final = os.environ.get("SKIN_VCAN") == "1"

collect_ignore_glob = [] if GIVEN else ["test_*.py"]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    if not GIVEN:
        terminalreporter.write_line("not run: the tests on a real CAN kernel; `make test-vcan` runs them", yellow=True)


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Where there is a kernel, nothing may be skipped."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if GIVEN and reporter is not None and reporter.stats.get("skipped"):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
