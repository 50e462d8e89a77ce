"""The notebook and the cell as pytest sees them."""

import os
import re
import time
from collections.abc import Iterator
from pathlib import Path
from queue import Empty
from typing import Any

import pytest
from nbval.plugin import IPyNbCell, IPyNbFile, NbCellError

from nbregress.outputs import outputs_differences
from nbregress.tolerance import configured_tolerance, tolerance_tags

# How often a silent kernel is asked whether it is still there.
_POLL = 1.0
_NEVER = "was never executed before it was saved: there is nothing to compare with"
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")


class KernelDiedError(Exception):
    """The kernel went away while a cell was running."""


class NotebookFile(IPyNbFile):
    """A notebook under regression: nbval's, with its own cells."""

    problem: str | None = None

    def collect(self) -> Iterator[pytest.Item]:
        """One item for each code cell, or one that says why there are none."""
        try:
            cells = list(super().collect())
        except Exception as error:
            # An error raised here would end the whole run.
            lines = str(error).strip().splitlines() or [type(error).__name__]
            yield Unreadable.from_parent(self, name="notebook", reason=lines[0][:200])
            return
        for old in cells:
            yield NotebookCell.from_parent(
                self,
                name=old.name,
                cell_num=old.cell_num,
                cell=old.cell,
                options=old.options,
            )

    def setup(self) -> None:
        """Start the kernel; a failure is the first cell's to report."""
        if not hasattr(self, "nb"):
            return
        code = [c for c in self.nb.cells if c.cell_type == "code" and c.source.strip()]
        if code and all(c.execution_count is None and not c.outputs for c in code):
            self.problem = f"{_NEVER}; to accept: {self.refresh_command}"
            return
        environment = {"PYTHONHASHSEED": os.environ.get("PYTHONHASHSEED"), "MPLBACKEND": None}
        saved = {name: os.environ.pop(name, None) for name in environment}
        os.environ["PYTHONHASHSEED"] = environment["PYTHONHASHSEED"] or "0"
        try:
            super().setup()
            _improve(self.kernel)
        except Exception as error:
            self.problem = f"has no kernel: {type(error).__name__}: {error}"
        finally:
            for name, value in saved.items():
                os.environ.pop(name, None)
                if value is not None:
                    os.environ[name] = value

    @property
    def shown_path(self) -> str:
        """The path as a reader in the invoking shell would write it."""
        try:
            return str(os.path.relpath(self.path, self.config.invocation_params.dir))
        except ValueError:  # on another drive
            return str(self.path)

    @property
    def refresh_command(self) -> str:
        """The command that accepts what the notebook produces now."""
        return f"python -m nbregress refresh {self.shown_path}"

    def teardown(self) -> None:
        """Close the kernel, whatever state it is in."""
        try:
            super().teardown()
        finally:
            if self.kernel is not None and hasattr(self.kernel, "km"):
                self.kernel.stop()


def _improve(kernel: Any) -> None:
    """Run cells as Jupyter does, remember the replies, notice a dead kernel."""
    get_message = kernel.get_message
    kernel.last_status = None
    # The history is what tells IPython of a semicolon; it need not end in the user's file.
    if str(kernel.language).startswith("python"):
        quiet = "get_ipython().history_manager.enabled = False"
        kernel.await_idle(kernel.kc.execute(quiet, silent=True, store_history=False), 60)

    def execute_cell_input(source: str, allow_stdin: bool | None = None) -> str:
        # nbval leaves the history out, and with it what `;` at the end of a cell means.
        kernel.last_status = None
        return str(
            kernel.kc.execute(
                source, store_history=True, allow_stdin=allow_stdin, stop_on_error=False
            )
        )

    def get_message_alive(stream: str, timeout: float | None = None) -> Any:
        end = None if timeout is None else time.monotonic() + timeout
        while True:
            left = _POLL if end is None else max(end - time.monotonic(), 0.0)
            try:
                message = get_message(stream, timeout=min(left, _POLL))
            except Empty:
                if not kernel.is_alive():
                    raise KernelDiedError from None
                if end is not None and time.monotonic() >= end:
                    raise
                continue
            if stream == "shell":
                kernel.last_status = message["content"].get("status")
            return message

    kernel.execute_cell_input = execute_cell_input
    kernel.get_message = get_message_alive


class Unreadable(pytest.Item):
    """Stands for a notebook that cannot be read."""

    def __init__(self, *, reason: str, **kwargs: Any) -> None:
        super().__init__(**kwargs)
        self.reason = reason

    def runtest(self) -> None:
        """Fail with the reason."""
        pytest.fail(f"{self.path} is not a readable notebook: {self.reason}", pytrace=False)

    def reportinfo(self) -> tuple[Path, int, str]:
        """The place as pytest prints it."""
        return self.path, 0, f"{self.path.name}::notebook"


class NotebookCell(IPyNbCell):
    """A code cell whose outputs are compared by numbers and figure data."""

    def setup(self) -> None:
        """Skip what cannot run any more; the cell that broke it has failed."""
        if self.parent.timed_out:
            pytest.skip("a cell before this one timed out")
        if self.parent.problem is not None and self is not self._first():
            pytest.skip("the notebook cannot run; see its first failure")

    def _first(self) -> Any:
        return next(item for item in self.session.items if item.parent is self.parent)

    def runtest(self) -> None:
        """Execute the cell and compare, or say why that proves nothing."""
        if self.parent.problem is not None:
            self.raise_cell_error(f"the notebook {self.parent.problem}")
        try:
            self.tolerance = configured_tolerance(self.config)._replace(**tolerance_tags(self.cell))
        except ValueError as error:
            self.raise_cell_error(str(error))
        try:
            super().runtest()
        except KernelDiedError:
            self.parent.problem = "lost its kernel"
            self.raise_cell_error("the kernel died while executing this cell")
        if not self.cell.source.strip():
            return
        raised = self.parent.kernel.last_status == "error"
        if raised and not self.options["check_exception"]:
            self.raise_cell_error("the cell failed", _printed(self.test_outputs))
        if self.options["check_exception"] and not raised:
            self.raise_cell_error("expected to raise an exception, but nothing was raised")
        if self.cell.execution_count is None:
            self.raise_cell_error(f"the cell {_NEVER}", self._accept())

    def compare_outputs(self, test: Any, ref: Any, skip_compare: Any = None) -> bool:
        """Whether the outputs agree; called by nbval."""
        stored, new = self.sanitize_outputs(ref), self.sanitize_outputs(test)
        messages = outputs_differences(stored, new, self.tolerance)
        self.comparison_traceback = [*messages, self._accept()] if messages else []
        return not messages

    def repr_failure(self, excinfo: Any, style: Any = None) -> str:
        """The report of a failure: where, what, how to accept it."""
        error = excinfo.value
        if not isinstance(error, NbCellError):
            return str(super().repr_failure(excinfo))
        count = self.cell.execution_count
        place = f"{self.parent.shown_path}, cell {self.cell_num}" + (
            f" (In [{count}])" if count else ""
        )
        lines = [f"{place}: {error}"]
        if error.inner_traceback:
            lines.append(_COLOUR.sub("", error.inner_traceback).strip("\n"))
        lines += ["", *(f"    {line}" for line in error.source.splitlines())]
        return "\n".join(lines)

    def _accept(self) -> str:
        return f"to accept: {self.parent.refresh_command}"


def _printed(outputs: Any) -> str:
    return "".join(o["text"] for o in outputs or () if o["output_type"] == "stream")
