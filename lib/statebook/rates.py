"""The rates of systems as functions of a module, not closures: so that a system pickles."""

import copyreg
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from statebook.probes import copied

Function = Callable[..., Any]


def of_model(f: Function, x: np.ndarray, u: np.ndarray, t: float) -> Any:
    """Evaluate f(x, u)."""
    return f(x, u)


def linear(A: np.ndarray, B: np.ndarray, x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
    """Evaluate A x + B u."""
    return A @ x + B @ u


def of_control(sys: Any, x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
    """Evaluate the dynamics of a control.NonlinearIOSystem, which may be its buffer."""
    return np.array(sys.dynamics(t, x, u))


def of_function(f: Function, number: int, x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
    """Evaluate a function of so many of x, u, t: apart from the caller's arrays and its own."""
    value = copied(f(*(x.copy(), u.copy(), t)[:number]))
    # A column for a state, as a SymPy matrix or a matrix product makes it.
    return value[:, 0] if value.ndim == x.ndim + 1 and value.shape[1] == 1 else value


def make_portable(kind: type) -> None:
    """Let control.StateSpace pickle: by itself it does not."""
    copyreg.pickle(kind, _reduced)


def _reduced(sys: Any) -> tuple[Any, ...]:
    kind: Callable[..., Any] = type(sys)
    names = {"states": sys.state_labels, "inputs": sys.input_labels, "outputs": sys.output_labels}
    make = partial(kind, **names, name=sys.name, remove_useless_states=False)
    return make, (*map(np.array, (sys.A, sys.B, sys.C, sys.D)), sys.dt)
