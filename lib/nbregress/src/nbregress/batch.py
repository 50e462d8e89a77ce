"""Several notebooks executed, each in its own kernel, and what became of each."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nbregress.background import Background, NotebookRun
from nbregress.session import NotebookError, cell_options, other_language
from nbregress.settings import SettingsError, load_settings
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
    finish: Callable[[Path, NotebookRun], str],
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
        ``finish(path, run)`` stores the result and says in a few words what it did.
    jobs : int >= 1
        How many notebooks run at a time.
    given : mapping
        Settings of the command line.

    Returns
    -------
    failed : list of pathlib.Path
    """
    failed: list[Path] = []
    background = Background(jobs)
    queued: list[tuple[Path, NotebookRun | str]] = []
    try:
        for path in paths:
            try:
                settings = load_settings(path, given)
                stored = read(path)
                for cell in stored.cells:
                    settings.with_tags(cell)
                started = NotebookRun(stored, path.resolve().parent, settings)
                queued.append((path, started))
                background.submit(started)
            except (NotebookError, SettingsError) as error:
                queued.append((path, str(error)))
        for number, (path, run) in enumerate(queued, start=1):
            try:
                if isinstance(run, str):
                    raise NotebookError(run)
                _check(run)
                normalize(run.executed)
                notes = filter(None, (other_language(run.stored), finish(path, run)))
                outcome = f"{run.seconds:.1f} s: {'; '.join(notes)}"
            except Exception as error:  # this notebook's alone in any case
                failed.append(path)
                kind = "" if isinstance(error, NotebookError) else f"{type(error).__name__}: "
                outcome = f"FAILED {kind}{error}"
            print(f"[{number}/{len(paths)}] {path} {outcome}", file=sys.stderr, flush=True)
    finally:
        background.close()
    return failed


def _check(run: NotebookRun) -> None:
    """Wait for all cells; the first that fails untagged, or does not though tagged, counts."""
    nb = run.executed
    for index in run.cells:
        cell = nb.cells[index]
        options = cell_options(cell)
        if options.get("skip") or not cell.source.strip():
            continue
        error = run.cell(index).error
        place = f"In [{cell.execution_count}] (cell {index + 1} of {len(nb.cells)})"
        if error is not None and not options.get("check_exception"):
            raise NotebookError(f"{place}: {error}")
        if error is None and options.get("check_exception"):
            raise NotebookError(f"{place}: tagged raises-exception, but nothing was raised")
    run.done.result()
