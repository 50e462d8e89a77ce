"""Several notebooks executed, each in its own kernel, and what became of each."""

import asyncio
import copy
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nbregress.session import CellRun, NotebookError, Session, cell_options, execute
from nbregress.settings import Settings, SettingsError, load_settings
from nbregress.store import normalize, read


def find_notebooks(names: Sequence[str]) -> tuple[list[Path], list[str]]:
    """Notebooks that files, folders and patterns name.

    Parameters
    ----------
    names : sequence of str
        A folder stands for all notebooks in and below it, but for checkpoints and hidden
        folders; ``*`` and ``?`` need no shell.

    Returns
    -------
    paths : list of pathlib.Path
        Each once.
    unknown : list of str
        Names that stand for nothing.
    """
    paths: dict[Path, None] = {}
    unknown = []
    for name in names:
        path = Path(name)
        found = [path] if path.exists() else []
        if not found and any(c in name for c in "*?["):
            found = sorted(Path(path.anchor).glob(str(path.relative_to(path.anchor))))
        found = [inside for path in found for inside in _inside(path)]
        if not found:
            unknown.append(name)
        paths |= dict.fromkeys(found)
    return list(paths), unknown


def _inside(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    found = sorted(path.rglob("*.ipynb"))
    return [p for p in found if not any(n.startswith(".") for n in p.relative_to(path).parts)]


def run_all(
    paths: Sequence[Path],
    finish: Callable[[Path, Any, Any, Settings], str],
    *,
    jobs: int,
    given: Mapping[str, Any],
) -> list[Path]:
    """Execute several notebooks, each in its own kernel.

    One line for each notebook goes to stderr. A failure does not stop the others. The next
    kernel starts while the cells before it still run.

    Parameters
    ----------
    paths : sequence of pathlib.Path
    finish : callable
        ``finish(path, stored, executed, settings)`` stores the result and says in a few
        words what it did.
    jobs : int >= 1
        How many notebooks run at a time.
    given : mapping
        Settings of the command line.

    Returns
    -------
    failed : list of pathlib.Path
    """
    failed: list[Path] = []
    done = 0

    async def one(path: Path, ahead: asyncio.Semaphore, slot: asyncio.Semaphore) -> None:
        nonlocal done
        async with ahead:
            seconds = 0.0
            try:
                settings = load_settings(path, given)
                stored = read(path)
                for cell in stored.cells:
                    settings.with_tags(cell)
                nb = copy.deepcopy(stored)
                session = Session(nb, path.resolve().parent, settings)
                await session.start()
                async with slot:
                    start = time.monotonic()
                    try:
                        await _execute(session)
                    finally:
                        seconds = time.monotonic() - start
                normalize(nb)
                outcome = finish(path, stored, nb, settings)
            except (NotebookError, SettingsError) as error:
                failed.append(path)
                outcome = f"FAILED {error}"
            except Exception as error:  # a fault of ours: this notebook's alone in any case
                failed.append(path)
                outcome = f"FAILED {type(error).__name__}: {error}"
            done += 1
            print(f"[{done}/{len(paths)}] {path} {seconds:.1f} s: {outcome}", file=sys.stderr)

    async def every() -> None:
        ahead, slot = asyncio.Semaphore(jobs + 1), asyncio.Semaphore(jobs)
        await asyncio.gather(*(one(path, ahead, slot) for path in paths))

    asyncio.run(every())
    return failed


async def _execute(session: Session) -> None:
    """Execute all cells; the first that fails untagged, or does not though tagged, counts."""
    problems = []

    def check(run: CellRun) -> None:
        cell = session.nb.cells[run.index]
        expected = cell_options(cell).get("check_exception", False)
        place = f"In [{cell.execution_count}] (cell {run.index + 1} of {len(session.nb.cells)})"
        if run.error is not None and not expected:
            problems.append(f"{place}: {run.error}")
        elif run.error is None and expected and cell.source.strip():
            problems.append(f"{place}: tagged raises-exception, but nothing was raised")
        if problems:
            raise NotebookError(problems[0])

    await execute(session, on_cell=check)
