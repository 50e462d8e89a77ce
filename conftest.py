"""Where toppra is not installed, skip the examples that time a path (run.py names the chapters).

Properties are tested on the same examples each time; `--hypothesis-profile=search` draws others. No
example fails for being slow: on a busy machine each may be.
"""

import importlib.util

import pytest
from hypothesis import HealthCheck, settings

patient = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("search", patient)
settings.register_profile("same", patient, derandomize=True)
settings.load_profile("same")

collect_ignore_glob = ["lib/statebook/analysis/*.ipynb"]  # a template has no outputs


def pytest_collection_modifyitems(items):
    """Skip doctests that call time_scale."""
    if importlib.util.find_spec("toppra") is not None:
        return
    for item in items:
        if isinstance(item, pytest.DoctestItem) and any(
            "time_scale(" in example.source for example in item.dtest.examples
        ):
            item.add_marker(pytest.mark.skip(reason="toppra is not installed"))
