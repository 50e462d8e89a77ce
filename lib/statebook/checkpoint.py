"""What a long computation has done, folded or kept, and a file from which it goes on."""

import copy
import functools
import json
import os
import time
import warnings
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np

_SECONDS = 1.0  # between two writings, which take a twentieth of the time at most


def stacked(results: list[np.ndarray]) -> np.ndarray:
    """Stack results of one shape."""
    shapes = sorted({result.shape for result in results})
    if len(shapes) > 1:
        raise ValueError(f"function must return results of one shape, got {shapes}")
    return np.stack(results)


class Checkpoint:
    """Results of parts of a computation: folded in order, or all kept.

    Parameters
    ----------
    size : int > 0
        Points a part.
    reduce : (function, initial), optional
    """

    def __init__(self, size: int, reduce: Any = None) -> None:
        pair = isinstance(reduce, tuple) and len(reduce) == 2
        if reduce is not None and not (pair and callable(reduce[0])):
            raise TypeError(f"reduce must be (function, initial), got {reduce!r}")
        self.size = size
        self.fold: Any = reduce and reduce[0]
        self.state = 0, reduce[1] if reduce else 0  # points folded, and their total
        self.ready: dict[int, np.ndarray] = {}  # other parts, by their first points
        self.file: Path | None = None
        self.due = 0.0

    def missing(self, number: int) -> deque[range]:
        """Return the parts of so many points that are not there yet."""
        starts = [i for i in range(self.state[0], number, self.size) if i not in self.ready]
        return deque(range(i, min(i + self.size, number)) for i in starts)

    def add(self, start: int, results: np.ndarray) -> None:
        """Take the results of a part."""
        stacked([results[0], next(iter(self.ready.values()), results)[0]])
        self.ready[start] = results
        self._fold()
        if self.file and time.monotonic() >= self.due:
            self.save()

    def _fold(self) -> None:
        while self.fold and self.state[0] in self.ready:
            count, total = self.state
            total = functools.reduce(self.fold, self.ready[count], copy.deepcopy(total))
            # In one step, as an interruption may follow.
            self.state = count + len(self.ready[count]), total
            del self.ready[count]

    def result(self, shape: tuple[int, ...]) -> Any:
        """Return the total, or all results in order."""
        self._fold()
        if self.fold:
            return self.state[1]
        results = np.concatenate([self.ready[start] for start in sorted(self.ready)])
        return results.reshape(shape + results.shape[1:])

    def keep_in(self, file: str | os.PathLike[str], key: dict[str, str]) -> None:
        """Go on from a file, if it is there and of this key, and write it from now on."""
        self.file = Path(file)
        name = getattr(self.fold, "__qualname__", type(self.fold).__qualname__)
        self.key = {**key, "reduction": f"{name} {np.asarray(self.state[1]).tolist()}"}
        if self.file.exists():
            try:
                with self.file.open("rb") as opened, np.load(opened, allow_pickle=False) as stored:
                    known = json.loads(str(stored["key"]))
                    self.size, count = int(stored["size"]), int(stored["count"])
                    total, starts, results = stored["total"], stored["starts"], stored["results"]
            except Exception as error:
                raise ValueError(f"cache must be a file of sweep's: {file} ({error})") from None
            if other := ", ".join(n for n in self.key if known.get(n) != self.key[n]):
                said = f"cache must be of this sweep, and {file} is of another {other}: delete it"
                raise ValueError(f"{said}, or name another file")
            self.state = count, total[()]
            blocks = np.split(results, range(self.size, len(results), self.size))
            self.ready = dict(zip(starts.tolist(), blocks, strict=False))
        self._write()

    def save(self) -> None:
        """Write the file; a full disk is a warning, as results are worth more."""
        try:
            self._write()
        except OSError as error:
            warnings.warn(f"sweep goes on, its cache cannot be written: {error}", stacklevel=4)

    def _write(self) -> None:
        assert self.file is not None
        began = time.monotonic()
        total = np.asarray(self.state[1])
        if isinstance(self.state[1], list | tuple) or total.dtype.kind not in "biufc":
            raise TypeError(f"reduce must keep a number or an array for a cache, got {total!r}")
        starts = sorted(self.ready)
        results = np.concatenate([self.ready[i] for i in starts]) if starts else np.empty(0)
        arrays: dict[str, Any] = {"key": json.dumps(self.key), "size": self.size, "total": total}
        arrays |= {"count": self.state[0], "starts": starts, "results": results}
        beside = self.file.with_name(f"{self.file.name}.{os.getpid()}")
        try:
            with beside.open("wb") as file:
                np.savez(file, **arrays)
            os.replace(beside, self.file)
        finally:
            beside.unlink(missing_ok=True)
        now = time.monotonic()
        self.due = now + max(_SECONDS, 20 * (now - began))
