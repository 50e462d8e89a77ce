"""One view of every kind of system: x' = f(x, u), or x_next = f(x, u)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from statebook import _validate
from statebook.probes import arguments_of, require_pure, spread_beside, takes_batches


@dataclass(frozen=True)
class System:
    """A state-space system with labels and a timebase.

    Attributes
    ----------
    states, inputs : tuple of str
        Labels; their numbers are n and m.
    dt : float, bool or None
        None or 0 is continuous time, True or > 0 [s] discrete, as in python-control.
    linear : bool
        The system declares itself linear in x and u.
    name : str
        A name for messages and figures.
    source : object
        What the system was made from.
    """

    rate: Callable[[Any, Any, float], Any] = field(repr=False)
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    dt: float | bool | None = None
    linear: bool = False
    name: str = "system"
    source: Any = field(default=None, repr=False)
    batched: bool = True

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def discrete(self) -> bool:
        """Whether f is a map from one sample to the next."""
        return self.dt is not None and (self.dt is True or self.dt > 0)

    def dynamics(self, x: Any, u: Any = None, t: float = 0.0) -> np.ndarray:
        """Evaluate f(x, u) at one state or a batch of states.

        Parameters
        ----------
        x : array, shape (n,) or (n, N)
        u : array, shape (m,) or (m, N), optional
            Zeros if omitted.
        t : float [s]
            Time, for a python-control system that depends on it.

        Returns
        -------
        array, shape (n,) or (n, N)

        Raises
        ------
        TypeError, ValueError
            An argument, or what f returned, has the wrong type, shape or is not finite.

        Examples
        --------
        >>> import statebook as sb
        >>> sb.as_system(lambda x: -2 * x, [1.0]).dynamics([3.0])
        array([-6.])
        """
        x, u = _validate.state_and_input(x, u, self.n, self.m)
        if x.ndim > u.ndim:  # one input for all: a function need not know that case
            u = np.repeat(u[:, None], x.shape[1], axis=1)
        if x.ndim == 1 or self.batched:
            return self._check(self.rate(x, u, t), x)
        columns = [self._check(self.rate(*xu, t), xu[0]) for xu in zip(x.T, u.T, strict=True)]
        return np.stack(columns, axis=1) if columns else np.empty(x.shape)

    def probe(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Evaluate f at a batch that may leave its domain.

        Parameters
        ----------
        x, u : array, shape (n, N) and (m, N)

        Returns
        -------
        array, shape (n, N)
            NaN in the columns where f is undefined or raises an arithmetic error.

        Examples
        --------
        >>> import statebook as sb
        >>> sb.as_system(lambda x: 1 / x, [1.0]).probe(np.array([[0.5, 2.0]]), np.empty((0, 2)))
        array([[2. , 0.5]])
        """
        with np.errstate(all="ignore"):
            if self.batched:
                return np.asarray(self.rate(x, u, 0.0))
            columns = []
            for column in zip(x.T, u.T, strict=True):
                try:
                    columns.append(np.asarray(self.rate(*column, 0.0)))
                except (ValueError, ArithmeticError):  # math.sqrt(-1), 1 / 0
                    columns.append(np.full(self.n, np.nan))
            return np.stack(columns, axis=1)

    def _check(self, value: Any, x: np.ndarray) -> np.ndarray:
        try:
            return _validate.array("dynamics(x, u)", value, x.shape)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}, at x = {_validate.brief(x)}") from None


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


def _from_function(f: Callable[..., Any], x0: Any, u0: Any, dt: float | bool | None) -> System:
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
    number = max(state.size, drive.size) + 2
    beside = spread_beside(state, number), spread_beside(drive, number)

    def at_start(x: np.ndarray, u: np.ndarray) -> Any:
        return rate(x, u, 0.0)

    return System(
        rate=rate,
        states=tuple(f"x[{i}]" for i in range(state.size)),
        inputs=tuple(f"u[{i}]" for i in range(drive.size)),
        dt=dt,
        name=getattr(f, "__name__", type(f).__name__).replace("<lambda>", "function"),
        source=f,
        batched=takes_batches(at_start, *beside, alone=at_start, rtol=1e-12),
    )
