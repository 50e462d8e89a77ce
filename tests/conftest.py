"""A real browser to look at pages with, where there is one.

Needs a Chromium, and the extra "browser" (`run.py test` installs it where it finds a Chromium).
"""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "book"))


@pytest.fixture(scope="session")
def chromium():
    """The path of a Chromium; without one the test is skipped."""
    from paper import find_chromium

    path = find_chromium()
    if path is None:
        pytest.skip("no Chromium, Chrome or Edge is here")
    return path


@pytest.fixture(scope="module")
def browser(chromium):
    """The browser, started."""
    playwright = pytest.importorskip("playwright.sync_api", reason="the extra 'browser' is missing")
    with playwright.sync_playwright() as driver:
        try:
            found = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        except playwright.Error as error:
            pytest.skip(f"the browser does not start: {error}")
        yield found
        found.close()
