"""One way to run a notebook's cells, for the tests and for `refresh` alike."""

import asyncio
import os
import re
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jupyter_client.kernelspec import NoSuchKernel
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellTimeoutError, DeadKernelError
from nbval.kernel import CURRENT_ENV_KERNEL_NAME, NbvalKernelspecManager
from nbval.plugin import find_comment_markers, find_metadata_tags

from nbregress.settings import Settings
from nbregress.widgets import attach_widgets

# What a kernel must not take over from the process that starts it: it would be run otherwise
# by pytest than by `refresh`, here than on another machine.
_FIXED = {"PYTHONHASHSEED": "0", "COLUMNS": "80", "LINES": "24", "TZ": "UTC", "LC_ALL": "C.UTF-8"}
_DROPPED = re.compile(r"MPLBACKEND|PYTEST_|COV_CORE_|LANGUAGE$|FORCE_COLOR$|NO_COLOR$|CLICOLOR")
# Loads this package into the kernel, from where the runner has it; the history is what tells
# IPython of a semicolon, and need not end in the user's file.
_LOAD = """\
import importlib.util as _util, sys as _sys
if "nbregress" not in _sys.modules:
    _spec = _util.spec_from_file_location("nbregress", {!r}, submodule_search_locations=[{!r}])
    _sys.modules["nbregress"] = _util.module_from_spec(_spec)
    _spec.loader.exec_module(_sys.modules["nbregress"])
    del _spec
get_ipython().history_manager.enabled = False
_sys.modules["nbregress"].load_ipython_extension(get_ipython())
del _util, _sys
"""


class NotebookError(Exception):
    """A notebook that could not be executed; the message says where and why."""


class CellError(NotebookError):
    """A notebook that stopped at a cell; `index` is its place among all cells."""

    def __init__(self, message: str, index: int) -> None:
        super().__init__(message)
        self.index = index


@dataclass(frozen=True)
class CellRun:
    """How a cell ran.

    Parameters
    ----------
    index : int
        Its place among all cells.
    error : str or None
        The error that it raised, as "ValueError: ...".
    late : bool
        Whether cells after this one may change its outputs: updated displays and widgets.
    """

    index: int
    error: str | None
    late: bool


def cell_options(cell: Any) -> dict[str, bool]:
    """What nbval's tags and comments say about a cell.

    Parameters
    ----------
    cell : nbformat.NotebookNode

    Returns
    -------
    options : dict
        ``check`` and ``skip`` and ``check_exception``, where they are set.
    """
    return {**dict(find_metadata_tags(cell.metadata)), **dict(find_comment_markers(cell.source))}


def notebook_language(nb: Any) -> str:
    """Language of a notebook's kernel, in small letters.

    Parameters
    ----------
    nb : nbformat.NotebookNode

    Returns
    -------
    language : str
        "python" also for "python3" and where nothing is said.
    """
    language = nb.metadata.get("kernelspec", {}).get("language") or nb.metadata.get(
        "language_info", {}
    ).get("name", "python")
    return re.sub(r"^i?python[\d.]*$", "python", str(language).lower())


def other_language(nb: Any) -> str:
    """What is to be said of a notebook in another language than Python; else empty.

    Parameters
    ----------
    nb : nbformat.NotebookNode

    Returns
    -------
    note : str
    """
    language = notebook_language(nb)
    return f"language {language}: text compared, figures by pixels" if language != "python" else ""


class Session(NotebookClient):
    """A notebook with a kernel of its own.

    Parameters
    ----------
    nb : nbformat.NotebookNode
        Its code cells get new outputs.
    folder : pathlib.Path
        Working directory of the kernel.
    settings : Settings
    """

    def __init__(self, nb: Any, folder: Path, settings: Settings) -> None:
        super().__init__(
            nb,
            allow_errors=True,
            record_timing=False,
            coalesce_streams=False,
            iopub_timeout=60,
            startup_timeout=10**9,  # by a clock that may be set; `start` has a better one
            timeout_func=lambda cell: settings.timeout,
            resources={"metadata": {"path": str(folder)}},
            on_cell_executed=self._remember,
        )
        self.settings = settings
        self._reply: dict[str, Any] = {}
        self.log.disabled = True

    async def start(self, prepare: Sequence[str] = (), again: bool = True) -> None:
        """Start the kernel and get it ready for the first cell.

        One that dies at once is started once more: between the choice of its ports and its use of
        them another program may take one.

        Parameters
        ----------
        prepare : sequence of str
            Further code to execute first, in silence.
        again : bool
            Whether to start it once more.

        Raises
        ------
        NotebookError
            If there is no such kernel, or it does not start.
        """
        language = notebook_language(self.nb)
        own = str(self.nb.metadata.get("kernelspec", {}).get("name", language))
        wanted = self.settings.kernel or (CURRENT_ENV_KERNEL_NAME if language == "python" else own)
        specs = NbvalKernelspecManager()
        try:
            specs.get_kernel_spec(wanted)
        except NoSuchKernel:
            there = ", ".join(sorted(specs.find_kernel_specs())) or "none"
            raise NotebookError(
                f"has no kernel: it wants {wanted!r} (language {language}), and here there are: "
                f"{there}; install it, or name another one with --kernel"
            ) from None
        self.km = AsyncKernelManager(kernel_name=wanted, kernel_spec_manager=specs)
        try:
            # What the kernel process itself says is noise; the cells' stderr is an output.
            kept = {name: value for name, value in os.environ.items() if not _DROPPED.match(name)}
            environment = {**kept, **_FIXED, **self.settings.env}
            await self.async_start_new_kernel(env=environment, stderr=subprocess.DEVNULL)
            await asyncio.wait_for(self.async_start_new_kernel_client(), 60)
            package = Path(__file__).parent
            load = _LOAD.format(str(package / "__init__.py"), str(package))
            for code in [load, *prepare] if language == "python" else prepare:
                await self._silently(code)
        except Exception as error:
            await self.close()
            if again and isinstance(error, RuntimeError):
                return await self.start(prepare, again=False)
            raise NotebookError(
                f"has no kernel: {wanted} does not start: {type(error).__name__}: {error}"
            ) from error

    async def run(self, index: int) -> CellRun:
        """Execute one cell.

        Parameters
        ----------
        index : int
            Its place among all cells.

        Returns
        -------
        run : CellRun

        Raises
        ------
        CellError
            If the cell takes too long, or the kernel dies.
        """
        cell = self.nb.cells[index]
        self._reply = {}
        try:
            await self.async_execute_cell(cell, index)
        except CellTimeoutError:
            raise CellError(
                f"Timeout of {self.settings.timeout:g} seconds exceeded executing cell", index
            ) from None
        except (DeadKernelError, RuntimeError):
            raise CellError(await self._obituary(), index) from None
        cell["execution_count"] = self._reply.get("execution_count")
        if "parameters" in cell.metadata.get("tags", []):
            given = "\n".join(f"{k} = {v!r}" for k, v in self.settings.parameters.items())
            if given:
                await self._silently(given)
        failed = self._reply.get("status") == "error"
        error = f"{self._reply.get('ename')}: {self._reply.get('evalue')}" if failed else None
        shown = any(index in places for places in self._display_id_map.values())
        late = shown or any(
            "widget-view" in mime for o in cell.outputs for mime in o.get("data", ())
        )
        return CellRun(index, error, late)

    async def close(self, finish: Sequence[str] = ()) -> None:
        """Shut the kernel down, whatever state it is in.

        Parameters
        ----------
        finish : sequence of str
            Code to execute before, in silence.
        """
        if self.km is None:
            return
        process: Any = getattr(getattr(self.km, "provisioner", None), "process", None)
        try:
            for code in finish:
                await self._silently(code)
        finally:
            self.shutdown_kernel = "immediate"
            try:
                await self._async_cleanup_kernel()
            finally:  # where this is cancelled too, no process is left behind
                if process is not None:
                    process.kill()
                    process.wait()

    async def _silently(self, code: str) -> None:
        assert self.kc is not None
        await self.async_wait_for_reply(self.kc.execute(code, silent=True, store_history=False))

    def _remember(self, execute_reply: dict[str, Any], **_: Any) -> None:
        self._reply = execute_reply["content"]

    async def _obituary(self) -> str:
        process: Any = getattr(getattr(self.km, "provisioner", None), "process", None)
        code = process.poll() if process is not None else None
        end = f" (exit code {code})" if code is not None else ""
        if code == -9:
            end = ": the system killed it, as it does when memory runs out"
        return f"the kernel died while executing this cell{end}"


async def execute(
    session: Session,
    *,
    until: int | None = None,
    on_cell: Callable[[CellRun], None] = lambda run: None,
    finish: Sequence[str] = (),
) -> None:
    """Execute the cells of a started session in order, and close it.

    Cells tagged ``nbval-skip`` keep their outputs and are not executed.

    Parameters
    ----------
    session : Session
    until : int, optional
        The last cell to execute; default: all.
    on_cell : callable
        Called as ``on_cell(run)`` after each code cell that was executed.
    finish : sequence of str
        Code to execute at the end, in silence.

    Raises
    ------
    CellError
        If a cell takes too long, or the kernel dies.
    """
    try:
        for index, cell in enumerate(session.nb.cells[: None if until is None else until + 1]):
            if cell.cell_type != "code" or cell_options(cell).get("skip"):
                continue
            if not cell.source.strip():
                cell["outputs"], cell["execution_count"] = [], None
                on_cell(CellRun(index, None, False))
                continue
            on_cell(await session.run(index))
        keep = "widgets" in session.nb.metadata
        session.set_widgets_metadata()
        attach_widgets(session.nb, keep)
    except asyncio.CancelledError:
        finish = ()
        raise
    finally:
        await session.close(finish)
