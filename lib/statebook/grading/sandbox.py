"""Run a check in a process of its own, for a limited time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from typing import Any

TIMEOUT = 30.0  # [s]

# Both ways by pickle through pipes between this process and its child; nothing from files.
_CHILD = """
import sys, cloudpickle
real, sys.stdout = sys.stdout.buffer, sys.stderr
check, arguments = cloudpickle.loads(sys.stdin.buffer.read())
try:
    answer = check(*arguments)
except BaseException as error:
    answer = f"your answer raised {type(error).__name__}: {error}"
real.write(cloudpickle.dumps(answer))
"""


def run_apart(check: Callable[..., str], *arguments: Any) -> str:
    """Return check(*arguments) from a process of its own, or why there is no answer.

    What the process prints is dropped; when it does not end within 30 s it is ended.

    Raises
    ------
    ModuleNotFoundError
        cloudpickle, which takes a notebook's functions along, is not installed.
    """
    try:
        import cloudpickle
    except ImportError as error:
        raise ModuleNotFoundError(
            'grading functions needs cloudpickle: pip install "statebook[lab]"'
        ) from error
    try:
        packed = cloudpickle.dumps((check, arguments))
    except Exception as error:
        return (
            f"your function cannot be taken to a process of its own ({error}); it must not use open"
            " files, figures or other things of this notebook"
        )
    try:
        child = subprocess.run(
            [sys.executable, "-c", _CHILD],
            input=packed,
            capture_output=True,
            timeout=TIMEOUT,
            # A function from a file beside the notebook is found there too.
            env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        )
    except subprocess.TimeoutExpired:
        return f"your answer was not done after {TIMEOUT:g} s: is there a loop without an end?"
    if child.returncode or not child.stdout:
        last = child.stderr.decode(errors="replace").strip().splitlines()[-1:]
        return "your answer ended its process" + (f": {last[0]}" if last else "")
    return str(cloudpickle.loads(child.stdout))
