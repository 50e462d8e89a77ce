"""Library models, functions and python-control objects as systems."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook import _validate
from statebook.systems.probes import arguments_of, require_pure, takes_batches
from statebook.systems.system import System


def as_system(
    system: Any, x0: Any = None, u0: Any = None, *, dt: float | bool | None = None
) -> System:
    """View anything that has dynamics as a System.

    Parameters
    ----------
    system : library model, function f(x, u) or f(x), control.NonlinearIOSystem or StateSpace
        A System is returned as it is.
    x0, u0 : array, shape (n,) or (n, N) and (m,) or (m, N), optional
        An example state and input. A function needs x0 to know n, and u0 to know m.
    dt : float, bool or None
        Timebase of a function. Other systems know theirs; a contradiction is refused.

    Returns
    -------
    System

    Raises
    ------
    TypeError
        The object has no dynamics.
    ValueError
        A needed x0 or u0 is missing, or dt contradicts the system's own.

    Notes
    -----
    ``batched`` is found by a probe: a batch of two states must give what its columns give.
    A function that fails the probe, and every control.NonlinearIOSystem (which flattens a
    batch), is called column by column.

    Examples
    --------
    >>> system = as_system(lambda x, u: [x[1], u[0] - 9.8], [0, 0], [0])
    >>> system.n, system.m, system.batched
    (2, 1, True)
    """
    if isinstance(system, System):
        result = system
    elif hasattr(system, "to_nlsys") and hasattr(system, "dynamics"):
        result = _from_model(system)
    elif hasattr(system, "nstates") and hasattr(system, "ninputs"):
        result = _from_control(system)
    elif callable(system):
        return _from_function(system, x0, u0, dt)
    else:
        raise TypeError(
            "system must be a library model, a function f(x, u) or f(x), a"
            f" control.NonlinearIOSystem or a control.StateSpace; got {type(system).__name__}"
        )
    if dt is not None and (dt != result.dt or (dt is True) != (result.dt is True)):
        if not (dt == 0 and not result.discrete):
            raise ValueError(
                f"dt = {dt} contradicts the timebase dt = {result.dt} of {result.name};"
                " leave it out"
            )
    return result


def _from_model(model: Any) -> System:
    return System(
        rate=lambda x, u, t: model.dynamics(x, u),
        states=tuple(model.states),
        inputs=tuple(model.inputs),
        linear=getattr(model, "linear", False),
        name=type(model).__name__,
        source=model,
    )


def _from_control(sys: Any) -> System:
    import control

    if isinstance(sys, control.StateSpace):
        A, B = np.asarray(sys.A), np.asarray(sys.B)

        def rate(x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
            return A @ x + B @ u
    elif isinstance(sys, control.NonlinearIOSystem) and sys.nstates is not None:

        def rate(x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
            return sys.dynamics(t, x, u)
    else:
        raise TypeError(
            f"system must be in state space, got {type(sys).__name__};"
            " convert it with control.ss() first"
        )
    return System(
        rate=rate,
        states=tuple(sys.state_labels),
        inputs=tuple(sys.input_labels),
        dt=sys.dt,
        linear=isinstance(sys, control.StateSpace),
        name=sys.name,
        source=sys,
        batched=isinstance(sys, control.StateSpace),
    )


def _from_function(f: Callable, x0: Any, u0: Any, dt: float | bool | None) -> System:
    if x0 is None:
        raise ValueError("x0 is required for a plain function: its length tells the state's")
    x0 = _validate.array("x0", x0)
    if x0.ndim not in (1, 2):
        raise ValueError(f"x0 must have shape (n,) or (n, N), got {x0.shape}")
    if dt is not None and dt is not True and (_validate.number("dt", dt) < 0):
        raise ValueError(f"dt must be None, True or at least 0, got {dt}")
    given = u0 is not None and np.size(u0) > 0
    u0 = _validate.array("u0", u0) if given else np.zeros(0)
    if u0.ndim not in (1, 2):
        raise ValueError(f"u0 must have shape (m,) or (m, N), got {u0.shape}")
    required, accepted = arguments_of(f)
    if given and accepted < 2:
        raise ValueError("u0 was given, but the function takes x alone: write it f(x, u)")
    if required == 2 and not given:
        raise ValueError("u0 is required for a function f(x, u): its length tells the input's")

    # Copies: a function that works in place must not change the caller's arrays.
    def rate(x: np.ndarray, u: np.ndarray, t: float) -> Any:
        return f(x.copy(), u.copy()) if given else f(x.copy())

    state, drive = (a if a.ndim == 1 else a[:, 0] for a in (x0, u0))
    require_pure(f, (state, drive) if given else (state,))
    return System(
        rate=rate,
        states=tuple(f"x[{i}]" for i in range(state.size)),
        inputs=tuple(f"u[{i}]" for i in range(drive.size)),
        dt=dt,
        name=getattr(f, "__name__", type(f).__name__).replace("<lambda>", "function"),
        source=f,
        batched=takes_batches(rate, state, drive),
    )
