"""Pytest plugin: notebooks with numeric tolerance, figure data and no false passes.

It acts only together with ``--nb``, or ``--nbval``, and loads nothing before.
"""

from collections import Counter
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of ``--nb`` and the ini settings."""
    group = parser.getgroup("nbregress", "numbers and figures in notebooks")
    update = "accept what the cells show now, in place (with -k: the selected cells')"
    group.addoption("--nb", action="store_true", help="execute notebooks and compare them")
    group.addoption("--nb-update", action="store_true", help=update)
    number: dict[str, Any] = {"dest": "nb_jobs", "type": int, "default": 1, "metavar": "N"}
    group.addoption("--jobs", help="notebooks to run at a time", **number)
    for name, metavar, text in (
        ("nb-report", "FILE", "HTML report: stored and new outputs side by side"),
        ("nb-timeout", "S", "longest time for one cell (default 300 s)"),
        ("regression-rtol", "X", "relative tolerance of numbers and figures (default 1e-5)"),
        ("regression-atol", "X", "absolute tolerance of numbers and figures (default 0)"),
    ):
        group.addoption(f"--{name}", metavar=metavar, help=text)
        if name.startswith("regression"):
            parser.addini(name.replace("-", "_"), text, default="")
    text = "compare what this noise pattern matches (the README has their names)"
    group.addoption("--nb-compare", action="append", metavar="NAME", help=text)


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Check the settings; with pytest-xdist, keep a notebook on one worker."""
    if not _active(config):
        return
    from nbregress.background import Background
    from nbregress.items import BACKGROUND, check_options
    from nbregress.settings import SettingsError

    option = config.option
    words = config.invocation_params.args
    if option.nb_timeout is None and any(
        str(word).startswith("--nbval-cell-timeout") for word in (*words, *config.getini("addopts"))
    ):
        option.nb_timeout = option.nbval_cell_timeout
    try:
        check_options(config)
    except SettingsError as error:
        raise pytest.UsageError(str(error)) from error
    chosen = any(str(word).startswith(("--dist", "-d")) for word in words)
    if getattr(option, "dist", "no") in ("load", "worksteal") and not chosen:
        option.dist = "loadfile"
    background = Background(option.nb_jobs)
    config.stash[BACKGROUND] = background
    config.add_cleanup(background.close)


@pytest.hookimpl(wrapper=True)
def pytest_collect_file(file_path: Path, parent: pytest.Collector) -> Generator[None, Any, Any]:
    """Collect notebooks, in place of nbval where it does."""
    collectors = yield
    if file_path.suffix == ".ipynb" and _active(parent.config):
        from nbregress.items import NotebookFile

        collectors = [c for c in collectors if type(c).__module__ != "nbval.plugin"]
        if ".ipynb_checkpoints" not in file_path.parts:
            collectors.append(NotebookFile.from_parent(parent, path=file_path))
    return collectors


def pytest_runtestloop(session: pytest.Session) -> None:
    """Queue the notebooks in the order of their tests, before the first test waits."""
    # A worker of pytest-xdist is told only later which of the tests are its own.
    option = session.config.option
    alone = getattr(option, "dist", "no") == "no" and not hasattr(session.config, "workerinput")
    if not alone or option.collectonly or not _active(session.config):
        return
    from nbregress.items import NotebookFile

    for notebook in dict.fromkeys(item.parent for item in session.items):
        if isinstance(notebook, NotebookFile):
            notebook.setup()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, Any, Any]:
    """Hand what the reports need of a cell to them, across processes too."""
    report = yield
    if call.when == "call" and _active(item.config):
        from nbregress.items import DETAILS

        details = item.stash.get(DETAILS, {})
        report.nbregress = {**details, "noise": sorted(details.get("noise", ()))}
    return report


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """Say which noise was met, and write the HTML report."""
    if not _active(config):
        return
    found = [
        report.nbregress
        for reports in terminalreporter.stats.values()
        for report in reports
        if getattr(report, "nbregress", None)
    ]
    noise = Counter(name for details in found for name in details["noise"])
    if noise:
        listed = ", ".join(f"{name} ({count})" for name, count in sorted(noise.items()))
        terminalreporter.write_line(f"noise that was not compared, in cells: {listed}")
    if config.option.nb_report:
        from nbregress.report import write_report

        path = write_report(Path(config.option.nb_report), found, noise)
        terminalreporter.write_line(f"notebooks' differences: {path}")


def _active(config: pytest.Config) -> bool:
    option = config.option
    return any(getattr(option, name, False) for name in ("nb", "nbval", "nb_update"))
