"""Execute notebooks and store their outputs reproducibly."""

import asyncio
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import ipykernel.kernelspec
import nbformat
from jupyter_client.kernelspec import KernelSpec, KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError

from nbregress.figures import MIME_TYPE
from nbregress.normalize import normalize
from nbregress.outputs import outputs_differences
from nbregress.tolerance import Tolerance, tolerance_tags


class NotebookError(Exception):
    """A notebook that could not be executed; the message says where and why."""


class _ThisPython(KernelSpecManager):
    """Whatever kernel is asked for, the Python that runs this."""

    def get_kernel_spec(self, kernel_name: str) -> KernelSpec:
        return KernelSpec(
            resource_dir=ipykernel.kernelspec.RESOURCES, **ipykernel.kernelspec.get_kernel_dict()
        )


class _Client(NotebookClient):
    def create_kernel_manager(self) -> AsyncKernelManager:
        self.km = AsyncKernelManager(kernel_name="python3", kernel_spec_manager=_ThisPython())
        return self.km


def read(path: Path) -> Any:
    """Read a notebook of format 4.

    Parameters
    ----------
    path : pathlib.Path
        The .ipynb file.

    Returns
    -------
    nb : nbformat.NotebookNode

    Raises
    ------
    NotebookError
        If the file is missing or is not a notebook, or wants a kernel that is not Python.
    """
    try:
        nb: Any = nbformat.read(path, as_version=4)
        nbformat.validate(nb)
    except (OSError, UnicodeDecodeError) as error:
        raise NotebookError(f"cannot be read: {error}") from error
    except (nbformat.reader.NotJSONError, nbformat.ValidationError, AttributeError) as error:
        first = str(error).strip().splitlines()[0][:200]
        raise NotebookError(f"is not a notebook: {first}") from error
    spec = nb.metadata.get("kernelspec", {})
    if spec.get("language", "python").lower() != "python":
        raise NotebookError(
            f"wants the kernel {spec.get('name')!r} (language {spec['language']}), "
            "but only Python notebooks can be executed"
        )
    return nb


def write(nb: Any, path: Path) -> bool:
    """Write a notebook if its text differs from the file's.

    The text is deterministic (sorted keys, indent 1, UTF-8, a newline at the end), and the
    file is replaced at once, so that an interruption leaves the old one.

    Parameters
    ----------
    nb : nbformat.NotebookNode
    path : pathlib.Path

    Returns
    -------
    changed : bool
        False if the file held the same bytes already.
    """
    data = (nbformat.writes(nb).rstrip("\n") + "\n").encode("utf-8")
    if path.exists() and path.read_bytes() == data:
        return False
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", delete=False) as file:
        file.write(data)
    if path.exists():
        os.chmod(file.name, path.stat().st_mode & 0o777)
    else:
        os.chmod(file.name, 0o644)
    os.replace(file.name, path)
    return True


def keep_agreeing(stored: Any, nb: Any) -> tuple[list[str], list[str]]:
    """Give the cells of an executed notebook their stored outputs where they agree.

    So a run on another machine, with other last digits and other picture bytes, changes
    nothing. A picture without a data digest agrees only if it is the same file.

    Parameters
    ----------
    stored : nbformat.NotebookNode
        The notebook as it was before it was executed.
    nb : nbformat.NotebookNode
        The same notebook, executed; changed in place.

    Returns
    -------
    changed : list of str
        The cells with new outputs, as "In [3]".
    kept : list of str
        The cells whose outputs were kept although they are not the same.
    """
    normalize(stored)
    changed, kept = [], []
    for old, cell in zip(stored.cells, nb.cells, strict=True):
        if cell.cell_type != "code" or old.outputs == cell.outputs:
            continue
        if outputs_differences(old.outputs, cell.outputs, Tolerance(**tolerance_tags(cell))) or (
            _bare_pictures(old) != _bare_pictures(cell)
        ):
            changed.append(f"In [{cell.execution_count}]")
        else:
            kept.append(f"In [{cell.execution_count}]")
            cell["outputs"] = old.outputs
            for output in cell.outputs:
                if output.output_type == "execute_result":
                    output["execution_count"] = cell.execution_count
    return changed, kept


def _bare_pictures(cell: Any) -> list[Any]:
    bundles = [output.get("data", {}) for output in cell.outputs]
    return [bundle.get("image/png") for bundle in bundles if MIME_TYPE not in bundle]


async def execute(nb: Any, folder: Path, timeout: float) -> None:
    """Execute a notebook in place, with its kernel closed at the end.

    Parameters
    ----------
    nb : nbformat.NotebookNode
    folder : pathlib.Path
        Working directory of the kernel.
    timeout : float > 0 [s]
        Longest time one cell may take.

    Raises
    ------
    NotebookError
        If a cell raises, one tagged ``raises-exception`` does not, a cell takes too long, or
        the kernel dies or does not start.
    """
    position = ""

    def entered(cell: Any, cell_index: int) -> None:
        nonlocal position
        count = sum(c.cell_type == "code" and bool(c.source.strip()) for c in nb.cells[:cell_index])
        position = f"In [{count + 1}] (cell {cell_index + 1} of {len(nb.cells)})"

    def started(**_: Any) -> None:
        # nbclient catches Ctrl-C per notebook; one Ctrl-C is to end them all.
        loop = asyncio.get_running_loop()
        for number in (signal.SIGINT, signal.SIGTERM):
            try:
                loop.remove_signal_handler(number)
            except NotImplementedError:  # Windows
                pass

    client = _Client(
        nb,
        timeout=timeout,
        record_timing=False,
        resources={"metadata": {"path": str(folder)}},
        on_notebook_start=started,
        on_cell_execute=entered,
    )
    environment = {k: v for k, v in os.environ.items() if k != "MPLBACKEND"}
    environment.setdefault("PYTHONHASHSEED", "0")
    try:
        # What the kernel process itself says is noise; the cells' stderr is an output.
        await client.async_execute(env=environment, stderr=subprocess.DEVNULL)
    except CellExecutionError as error:
        raise NotebookError(f"{position}: {error.ename}: {error.evalue}") from error
    except CellTimeoutError as error:
        raise NotebookError(f"{position}: took longer than {timeout:g} s") from error
    except Exception as error:
        # A dead kernel, or a fault in what talks to it: this notebook's alone in any case.
        where = position or "before the first cell"
        name = type(error).__name__
        raise NotebookError(f"{where}: the kernel failed: {name}: {error}") from error
    for index, cell in enumerate(nb.cells):
        tagged = "raises-exception" in cell.metadata.get("tags", [])
        if tagged and not any(output.output_type == "error" for output in cell.outputs):
            entered(cell, index)
            raise NotebookError(f"{position}: tagged raises-exception, but nothing was raised")


def run_all(
    paths: Sequence[Path],
    finish: Callable[[Path, Any], str],
    *,
    jobs: int,
    timeout: float,
) -> list[Path]:
    """Execute several notebooks, each in its own kernel.

    One line for each notebook goes to stderr. A failure does not stop the others.

    Parameters
    ----------
    paths : sequence of pathlib.Path
    finish : callable
        ``finish(path, executed)`` stores the result and says in a few words what it did.
    jobs : int >= 1
        How many kernels run at a time.
    timeout : float > 0 [s]
        Longest time one cell may take.

    Returns
    -------
    failed : list of pathlib.Path
    """
    failed: list[Path] = []
    done = 0

    async def one(path: Path, slot: asyncio.Semaphore) -> None:
        nonlocal done
        async with slot:
            start = time.monotonic()
            try:
                nb = read(path)
                await execute(nb, path.resolve().parent, timeout)
                normalize(nb)
                outcome = finish(path, nb)
            except NotebookError as error:
                failed.append(path)
                outcome = f"FAILED {error}"
            done += 1
            seconds = time.monotonic() - start
            print(f"[{done}/{len(paths)}] {path} {seconds:.1f} s: {outcome}", file=sys.stderr)

    async def every() -> None:
        slot = asyncio.Semaphore(jobs)
        await asyncio.gather(*(one(path, slot) for path in paths))

    asyncio.run(every())
    return failed
