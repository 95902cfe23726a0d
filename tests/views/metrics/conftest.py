"""Tests of an extra."""

from importlib.util import find_spec

collect_ignore_glob: list[str] = []
if find_spec("prometheus_client") is None:
    collect_ignore_glob.append("test_*.py")
    print("NOT TESTED: skin metrics, for want of prometheus_client: make setup")
