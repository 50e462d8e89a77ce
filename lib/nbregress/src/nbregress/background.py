"""Notebooks executed in the background of a pytest run, some at a time, in order."""

import asyncio
import copy
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from nbregress.session import CellRun, NotebookError, Session, execute
from nbregress.settings import Settings


class NotebookRun:
    """One notebook's run, to be waited for cell by cell.

    Parameters
    ----------
    nb : nbformat.NotebookNode
        As it is stored, and stays; `executed` is a copy.
    folder : pathlib.Path
    settings : Settings
    until : int or None
        The last cell to execute, by its place among all.
    prepare, finish : sequence of str
        Code to execute in silence before the first cell and after the last.
    """

    def __init__(
        self,
        nb: Any,
        folder: Path,
        settings: Settings,
        until: int | None = None,
        prepare: Sequence[str] = (),
        finish: Sequence[str] = (),
    ) -> None:
        self.stored, self.executed = nb, copy.deepcopy(nb)
        self.seconds = 0.0
        self.folder, self.settings, self.until = folder, settings, until
        self.prepare, self.finish = prepare, finish
        self.done: Future[None] = Future()
        self.cells: dict[int, Future[CellRun]] = {
            index: Future() for index, cell in enumerate(nb.cells) if cell.cell_type == "code"
        }

    def cell(self, index: int) -> CellRun:
        """Wait for a cell.

        Parameters
        ----------
        index : int

        Returns
        -------
        run : CellRun

        Raises
        ------
        NotebookError
            If the notebook stopped before the cell was done.
        """
        run = self.cells[index].result()
        if run.late:  # cells after it may still change what it shows
            self.done.exception()
        return run

    async def work(self, ahead: asyncio.Semaphore, slot: asyncio.Semaphore) -> None:
        """Start the kernel ahead of its turn, execute the cells when it has come.

        Parameters
        ----------
        ahead, slot : asyncio.Semaphore
            Of kernels that may have started, and of those that may execute.
        """
        error: BaseException = NotebookError("was not executed this far")
        try:
            async with ahead:
                session = Session(self.executed, self.folder, self.settings)
                await session.start(self.prepare)
                try:
                    await slot.acquire()
                except asyncio.CancelledError:
                    await session.close()
                    raise
                start = time.monotonic()
                try:
                    await execute(
                        session,
                        until=self.until,
                        on_cell=lambda run: self.cells[run.index].set_result(run),
                        finish=self.finish,
                    )
                finally:
                    self.seconds = time.monotonic() - start
                    slot.release()
        except NotebookError as problem:
            error = problem
        except Exception as problem:
            error = NotebookError(f"could not be executed: {type(problem).__name__}: {problem}")
        finally:
            for future in self.cells.values():
                if not future.done():
                    future.set_exception(error)
            self.done.set_result(None)


class Background:
    """A thread in which notebooks run.

    Parameters
    ----------
    jobs : int >= 1
        How many notebooks execute at a time.
    """

    def __init__(self, jobs: int) -> None:
        self._loop = asyncio.new_event_loop()
        self._tasks: list[Any] = []
        self._ahead, self._slot = asyncio.Semaphore(jobs + 1), asyncio.Semaphore(jobs)
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    def submit(self, run: NotebookRun) -> None:
        """Put a notebook into the queue.

        Parameters
        ----------
        run : NotebookRun
        """
        work = run.work(self._ahead, self._slot)
        self._tasks.append(asyncio.run_coroutine_threadsafe(work, self._loop))

    def close(self) -> None:
        """Cancel what still runs, with its kernels, and end the thread."""

        async def cancel() -> None:
            own = asyncio.current_task()
            tasks = [task for task in asyncio.all_tasks() if task is not own]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

        asyncio.run_coroutine_threadsafe(cancel(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
