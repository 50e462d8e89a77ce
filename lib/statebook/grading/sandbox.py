"""Call a student's function in a process of its own, for a limited time."""

from __future__ import annotations

import atexit
import functools
import io
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
from collections import ChainMap
from collections.abc import Callable, Sized
from contextlib import suppress
from numbers import Real
from typing import Any

import numpy as np

TIMEOUT = 30.0  # [s], of all calls together
MOST = 10_000  # entries of an answer


# cloudpickle takes a cached function for one of a module, where the child cannot find it.
_CACHED = type(functools.lru_cache(int))

_IDLE: dict[int, Apart] = {}  # by process: whose child judges the next numbers too


def _uncached(function: Any) -> tuple[Any, tuple[Any]]:
    return functools.lru_cache, (function.__wrapped__,)


class AnswerError(Exception):
    """What is wrong with an answer, in a sentence for the student."""


class Apart:
    """A function that is called in a process of its own.

    Values come back as JSON: nothing that the function does there, to NumPy or to statebook, can
    touch the judge. What it prints is dropped. In a browser, which has no processes, it is called
    here, for as long as it takes.

    Parameters
    ----------
    function : callable
    ours : bool
        Nothing in it is a student's: its process may judge the next answer too.

    Attributes
    ----------
    trouble : str
        The first thing that was wrong, whatever a caller made of the exception.

    Raises
    ------
    ModuleNotFoundError
        cloudpickle, which takes a notebook's functions along, is not installed.
    """

    def __init__(self, function: Callable[..., Any], ours: bool = False) -> None:
        self.trouble = ""
        self._ours, self._late = ours, False
        self._function = function
        self._child: Any = None
        try:
            import cloudpickle
        except ImportError as error:
            raise ModuleNotFoundError(
                'grading functions needs cloudpickle: pip install "statebook[lab]"'
            ) from error
        try:
            packed = io.BytesIO()
            table = ChainMap({_CACHED: _uncached}, cloudpickle.Pickler.dispatch_table)
            pickler = type("Pickler", (cloudpickle.Pickler,), {"dispatch_table": table})
            pickler(packed).dump(function)
            self._packed = packed.getvalue()
        except Exception as error:
            raise AnswerError(
                f"your function cannot be taken to a process of its own ({told(error)}); it must"
                " not use open files, figures or other things of this notebook"
            ) from error

    def __enter__(self) -> Apart:
        if sys.platform == "emscripten":
            return self
        idle = _IDLE.pop(os.getpid(), None) if self._ours else None
        self._child = (idle and idle.running()) or _child()
        self._timer = threading.Timer(TIMEOUT, self._end, [True])
        self._timer.daemon = True
        self._timer.start()
        with suppress(OSError):
            self._send(self._packed)
        return self

    def __exit__(self, raised: object, *_: object) -> None:
        if self._child is None:
            return
        self._timer.cancel()
        done = self._ours and not raised and not self.trouble  # else a reply may be on its way
        if not done or _IDLE.setdefault(os.getpid(), self) is not self:
            self.close()

    def running(self) -> Any:
        """Return the process if it is running."""
        if self._child.poll() is None:
            return self._child
        self.close()
        return None

    def close(self) -> None:
        """End the process."""
        self._end(False)
        with suppress(OSError), self._child:
            pass  # closes the pipes

    def __call__(self, *arguments: Any) -> Any:
        """Return function(*arguments), numbers.

        Raises
        ------
        AnswerError
            The function fails, changes its arguments, ends its process, or takes too long.
        """
        value = self.reply(*arguments)
        if isinstance(value, str):
            self._fail("your function must return numbers, got a text")
        return value

    def reply(self, *arguments: Any) -> Any:
        """Return function(*arguments), numbers or a text."""
        if self.trouble:
            raise AnswerError(self.trouble)
        try:
            if self._child is None:
                value, trouble = _called(self._function, arguments)
            else:
                self._send(arguments)
                reply = json.loads(self._child.stdout.readline(100 * MOST))
                value, trouble = reply["value"], reply["trouble"]
        except (OSError, ValueError, KeyError, TypeError):  # no reply, or one that it made itself
            self._fail(
                f"your answer was not done after {TIMEOUT:g} s: is there a loop without an end?"
                if self._late
                else "your answer ended its process, or wrote where its values are read"
            )
        if trouble:
            self._fail(str(trouble))
        return np.array(value, dtype=float)[()] if not isinstance(value, str) else value

    def _fail(self, trouble: str) -> None:
        self.trouble = trouble
        raise AnswerError(trouble)

    def _send(self, message: bytes | tuple[Any, ...]) -> None:
        """Send a function, packed, or arguments."""
        self._child.stdin.write(pickle.dumps(message))
        self._child.stdin.flush()

    def _end(self, late: bool) -> None:
        self._late = late
        with suppress(OSError):
            if sys.platform == "win32":
                self._child.kill()
            else:
                os.killpg(self._child.pid, signal.SIGKILL)


def _child() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-c", "from statebook.grading.sandbox import serve; serve()"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        # A function from a file beside the notebook is found there too.
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        start_new_session=True,  # what the function starts ends with it
    )


@atexit.register
def _end_idle() -> None:
    if idle := _IDLE.pop(os.getpid(), None):
        idle.close()


def told(error: BaseException) -> str:
    """Return an exception in one line that is never long."""
    text = ""
    with suppress(Exception):  # whatever a student's own exception does
        text = " ".join(str(error)[:1000].split())
    line = f"{type(error).__name__}: {text}" if text else type(error).__name__
    return line if len(line) <= 200 else line[:197] + "..."


def as_array(value: Any) -> np.ndarray:
    """Return a copy of a value as an array; of a mapping or a set as an object.

    Raises
    ------
    AnswerError
        It has far too many entries, which are not looked at.
    """
    if isinstance(value, Real) and not isinstance(value, bool):
        return np.array(float(value))  # an int of any length and a Fraction too
    if isinstance(value, dict | set):
        return np.array(value, dtype=object)
    sized = isinstance(value, Sized) and not isinstance(value, str)
    many = value.size if isinstance(value, np.ndarray) else len(value) if sized else 0
    if many > MOST:
        raise AnswerError(f"an answer has {MOST} entries at most, got {many}")
    array = np.array(value)
    return array.real if array.dtype.kind == "c" and not array.imag.any() else array


def kind(value: Any) -> str:
    """Return what a value is, in words."""
    if isinstance(value, str):
        return "a text"
    array = as_array(value)
    if array.dtype.kind not in "iuf":
        name = type(value).__name__[:40]
        if isinstance(value, list | tuple):
            return f"a {name} of other things than real numbers"
        return f"an array of {array.dtype}" if name == "ndarray" else f"a value of type {name}"
    return "a number" if array.shape == () else f"an array of shape {array.shape}"


def serve() -> None:
    """Read functions and arguments of the last one from stdin; write each value to stdout."""
    import cloudpickle

    requests, replies = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "w", encoding="ascii")
    nothing = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1, 2):
        os.dup2(nothing, stream)
    failed, function = "", None
    while True:
        message = pickle.load(requests)
        if isinstance(message, bytes):
            try:
                failed, function = "", cloudpickle.loads(message)
            except BaseException as error:
                failed = f"your function cannot be taken to a process of its own ({told(error)})"
            continue
        value, trouble = ("", failed) if failed else _called(function, message)
        replies.write(json.dumps({"value": value, "trouble": trouble}) + "\n")
        replies.flush()


def _called(function: Any, arguments: tuple[Any, ...]) -> tuple[Any, str]:
    """Call a function; return its value, or what is wrong with it."""
    given = [np.copy(a) if isinstance(a, np.ndarray) else a for a in arguments]
    state = ", ".join(np.array2string(np.asarray(a), precision=4) for a in arguments)
    where = f" at ({state})" if arguments else ""
    try:
        value = function(*given)
        if isinstance(value, str):
            return value[:1000], ""
        if value is None:
            return "", f"your function returns None{where}; does it end in return?"
        found = as_array(value)  # at once: it may be the function's own buffer
        if found.dtype.kind not in "iuf" or found.size > MOST:
            return "", f"your function must return numbers, got {kind(value)}{where}"
        if any(not np.array_equal(a, b) for a, b in zip(arguments, given, strict=True)):
            return "", "your function changes its argument; work on a copy"
    except AnswerError as error:
        return "", f"{error}{where}"
    except BaseException as error:
        return "", f"your {'function' if arguments else 'answer'} raised {told(error)}{where}"
    return found.astype(float).tolist(), ""
