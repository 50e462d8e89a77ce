"""The notebook and the cell as pytest sees them."""

import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from nbval.plugin import IPyNbCell, IPyNbFile, NbCellError

from nbregress.background import Background, NotebookRun
from nbregress.comparison import Comparison
from nbregress.outputs import outputs_differences
from nbregress.session import CellError, NotebookError, cell_options, other_language
from nbregress.settings import Settings, SettingsError, load_settings
from nbregress.store import keep_agreeing, normalize, read, write
from nbregress.textdiff import cut

_NEVER = "was never executed before it was saved: there is nothing to compare with"
_MOST_LINES = 40  # of a message
#: What the reports and the summary need of a cell.
DETAILS = pytest.StashKey[dict[str, Any]]()
BACKGROUND = pytest.StashKey[Background]()


class NotebookFile(IPyNbFile):
    """A notebook under regression: nbval's, with its own cells and kernel."""

    run: NotebookRun | None = None
    settings = Settings()
    problem: str | None = None

    def collect(self) -> Iterator[pytest.Item]:
        """One item for each code cell, or one that says why there are none."""
        try:
            self.nb = read(self.path)
            self.settings = load_settings(self.path, *_given(self.config))
        except (NotebookError, SettingsError) as error:
            # An error raised here would end the whole run.
            broken = Unreadable.from_parent(self, name="notebook")
            broken.reason = str(error)
            yield broken
            return
        code = (index for index, cell in enumerate(self.nb.cells) if cell.cell_type == "code")
        for number, index in enumerate(code):
            cell = self.nb.cells[index]
            title = str(cell.metadata.get("name") or "").replace("::", ":")
            given = {"check": self.compare_outputs, **cell_options(cell)}
            cell_fields = {"cell_num": number, "cell": cell, "options": given}
            name = f"Cell {number} {title}".rstrip()
            item = NotebookCell.from_parent(self, name=name, **cell_fields)
            item.index = index
            item.extra_keyword_matches.update(map(str, cell.metadata.get("tags", [])))
            yield item

    def setup(self) -> None:
        """Execute the notebook in the background, up to the last cell that is asked for."""
        if self.run is not None or self.problem is not None or not hasattr(self, "nb"):
            return
        code = [c for c in self.nb.cells if c.cell_type == "code" and c.source.strip()]
        unrun = code and all(c.execution_count is None and not c.outputs for c in code)
        if unrun and not self.updating:
            self.problem = f"{_NEVER}; {self.how_to_accept}"
            return
        items = [i for i in self.session.items if i.parent is self]
        whole = self.updating or len(items) == sum(c.cell_type == "code" for c in self.nb.cells)
        until = None if whole else max((i.index for i in items), default=-1)
        prepare, finish = _coverage(self.config, self.path)
        self.run = NotebookRun(self.nb, self.path.parent, self.settings, until, prepare, finish)
        self.config.stash[BACKGROUND].submit(self.run)

    @property
    def updating(self) -> bool:
        """Whether what the notebook shows now is accepted."""
        return bool(self.config.getoption("nb_update", False))

    @property
    def shown_path(self) -> str:
        """The path as a reader in the invoking shell would write it."""
        try:
            return str(os.path.relpath(self.path, self.config.invocation_params.dir))
        except ValueError:  # on another drive
            return str(self.path)

    @property
    def how_to_accept(self) -> str:
        """The command that accepts what the notebook produces now."""
        mark = '"' if " " in self.shown_path else ""
        return f"to accept: python -m nbregress refresh {mark}{self.shown_path}{mark}"

    def teardown(self) -> None:
        """With --nb-update, store the new outputs of the cells that were asked for."""
        run, self.run = self.run, None
        if run is None or not self.updating or self.problem is not None:
            return
        run.done.exception()
        items = {i.index for i in self.session.items if i.parent is self and not i.failed}
        normalize(run.executed)
        changed, _ = keep_agreeing(self.nb, run.executed, self.settings, items)
        try:
            write(run.executed, self.path, run.stored)
        except NotebookError as error:
            message = f"{self.shown_path} {error}"
            raise pytest.fail.Exception(message, pytrace=False) from None
        if changed:
            print(f"\n{self.shown_path}: new outputs of {', '.join(changed)} accepted")


def check_options(config: pytest.Config) -> None:
    """Read the settings that hold for all notebooks.

    Parameters
    ----------
    config : pytest.Config

    Raises
    ------
    SettingsError
        If one cannot be read.
    """
    if config.option.nb_jobs < 1:
        raise SettingsError(f"--jobs must be at least 1, got {config.option.nb_jobs}")
    load_settings(config.rootpath / "*.ipynb", *_given(config))


def _given(config: pytest.Config) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the command line and pytest's ini file set."""
    option = config.option
    given = {name: config.getoption(f"regression_{name}") for name in ("rtol", "atol")}
    given["kernel"] = option.nbval_kernel_name
    given["sanitize_with"] = option.nbval_sanitize_with
    given["timeout"] = config.getoption("nb_timeout", None)
    if config.getoption("nb_compare", None):
        given["compare"] = tuple(config.getoption("nb_compare"))
    ini = {name: config.getini(f"regression_{name}") or None for name in ("rtol", "atol")}
    return given, ini


def _coverage(config: pytest.Config, path: Path) -> tuple[list[str], list[str]]:
    """Code with which nbval starts and ends coverage within a kernel."""
    if not getattr(config.option, "cov_source", None):
        return [], []
    from nbval.cover import setup_coverage, teardown_coverage

    code: list[str] = []  # what nbval would execute in a kernel
    client = SimpleNamespace(execute=lambda text, **_: code.append(text))
    kernel = SimpleNamespace(language="python", kc=client, await_idle=lambda *_: None)
    setup_coverage(config, kernel, path)
    teardown_coverage(config, kernel)
    return code[:1], code[1:]


class Unreadable(pytest.Item):
    """Stands for a notebook that cannot be read."""

    index = -1
    failed = True
    reason = ""

    def runtest(self) -> None:
        """Fail with the reason."""
        told = {"messages": [f"the notebook {self.reason}"], "outputs": [[], []]}
        place = {"notebook": str(self.path), "cell": self.name, "source": ""}
        self.stash[DETAILS] = {**told, **place}
        pytest.fail(f"{self.path} is not a readable notebook: it {self.reason}", pytrace=False)


class NotebookCell(IPyNbCell):
    """A code cell whose outputs are compared by numbers and figure data."""

    index = 0
    failed = False

    def setup(self) -> None:
        """Skip what nbval's tag skips."""
        if self.options.get("skip"):
            pytest.skip("tagged nbval-skip")

    def runtest(self) -> None:
        """Wait for the cell and compare, or say why that proves nothing."""
        self.failed = True
        if self.parent.problem is not None:
            self._stopped(self.parent.problem)
        try:
            settings = self.parent.settings.with_tags(self.cell)
        except SettingsError as error:
            self.raise_cell_error(str(error))
        try:
            run = self.parent.run.cell(self.index)
        except NotebookError as error:
            if isinstance(error, CellError) and error.index >= self.index:
                self.parent.problem = str(error)
            self._stopped(str(error))
        new = self.parent.run.executed.cells[self.index].outputs
        self._compare(run, new, settings)
        self.failed = False

    def _stopped(self, problem: str) -> None:
        """Fail at the first cell that could not run, skip those after it."""
        if getattr(self.parent, "told", False):
            pytest.skip("the notebook stopped at a cell before this one; see its first failure")
        self.parent.told = True
        whole = problem.startswith(("has ", "was ", "could "))
        self.raise_cell_error(f"the notebook {problem}" if whole else problem)

    def _compare(self, run: Any, new: Any, settings: Settings) -> None:
        if not self.cell.source.strip():
            return
        comparison = Comparison(settings)
        self.stash[DETAILS] = {"noise": comparison.noise}
        if note := other_language(self.parent.nb):
            comparison.noise.add(note)
        expected = self.options.get("check_exception")
        if run.error is not None and not expected:
            self.raise_cell_error("the cell failed", cut(run.error, 2000) + _printed(new))
        if expected and run.error is None:
            self.raise_cell_error("expected to raise an exception, but nothing was raised")
        if self.parent.updating:
            return
        if self.cell.execution_count is None:
            self.raise_cell_error(f"the cell {_NEVER}", self.parent.how_to_accept)
        if not self.options["check"]:
            return
        messages = outputs_differences(self.cell.outputs, new, comparison)
        if messages:
            self._tell(messages, new)
            lines = [line for message in messages for line in message.splitlines()]
            more = len(lines) - _MOST_LINES
            lines = lines[:_MOST_LINES] + ([f"... and {more} more lines"] if more > 0 else [])
            self.raise_cell_error(
                "Cell outputs differ", "\n".join([*lines, self.parent.how_to_accept])
            )

    def raise_cell_error(self, message: str, *details: str) -> None:
        """Fail, and let the report say so, also where there was nothing to compare."""
        if "messages" not in self.stash.setdefault(DETAILS, {}):
            self._tell([message, *details], [])
        super().raise_cell_error(message, *details)

    def _tell(self, messages: list[str], new: Any) -> None:
        outputs = json.loads(json.dumps([self.cell.outputs, new]))
        place = {"notebook": self.parent.shown_path, "cell": self.name, "source": self.cell.source}
        self.stash[DETAILS] |= {**place, "messages": messages, "outputs": outputs}

    def repr_failure(self, excinfo: Any, style: Any = None) -> str:
        """The report of a failure: where, what, how to accept it."""
        error = excinfo.value
        if not isinstance(error, NbCellError):
            return str(pytest.Item.repr_failure(self, excinfo))
        count = self.cell.execution_count
        place = f"{self.parent.shown_path}, cell {self.cell_num}" + (
            f" (In [{count}])" if count else ""
        )
        lines = [f"{place}: {error}"]
        if error.inner_traceback:
            lines.append(error.inner_traceback.strip("\n"))
        source = error.source.splitlines()
        lines += ["", *(f"    {cut(line)}" for line in source[:_MOST_LINES])]
        return "\n".join(lines)

    def reportinfo(self) -> tuple[Path, int, str]:
        """The place as pytest and CI print it."""
        return self.path, self.index, f"{self.path.name}::{self.name}"


def _printed(outputs: Any) -> str:
    text = "".join(o["text"] for o in outputs or () if o["output_type"] == "stream")
    return f"\n{cut(text, 2000)}" if text else ""
