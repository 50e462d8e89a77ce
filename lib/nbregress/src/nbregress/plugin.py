"""Pytest plugin: nbval with numeric tolerance, figure data and no false passes.

It acts only together with ``--nbval``, and loads nothing before.
"""

from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from nbregress.tolerance import configured_tolerance

# nbval's own limit of 2000 s for a cell outlasts any patience, and most CI jobs.
_NBVAL_TIMEOUT, _TIMEOUT = 2000.0, 300.0


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add ``--regression-rtol`` and ``--regression-atol``, and their ini settings."""
    group = parser.getgroup("nbregress", "numbers and figures in notebooks (with --nbval)")
    for name, default, text in (
        ("rtol", "1e-5", "relative tolerance of numbers and figure data"),
        ("atol", "1e-12", "absolute tolerance of numbers and figure data"),
    ):
        group.addoption(f"--regression-{name}", metavar="X", help=f"{text} (default {default})")
        parser.addini(f"regression_{name}", text, default=default)


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Check the tolerances; with pytest-xdist, keep a notebook on one worker."""
    if not _active(config):
        return
    try:
        configured_tolerance(config)
    except ValueError as error:
        raise pytest.UsageError(str(error)) from error
    option = config.option
    if option.nbval_cell_timeout == _NBVAL_TIMEOUT:
        option.nbval_cell_timeout = _TIMEOUT
    if getattr(option, "dist", "no") in ("load", "worksteal"):
        option.dist = "loadfile"


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> Generator[None, Any, Any]:
    """Replace nbval's collector of a notebook by this plugin's."""
    collectors = yield
    if file_path.suffix == ".ipynb" and _active(parent.config):
        from nbval.plugin import IPyNbFile

        from nbregress.items import NotebookFile

        return [
            NotebookFile.from_parent(parent, path=file_path) if type(c) is IPyNbFile else c
            for c in collectors
        ]
    return collectors


def _active(config: pytest.Config) -> bool:
    return bool(config.getoption("nbval", False))
