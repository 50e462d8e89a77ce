"""One view of every kind of system: x' = f(x, u), or x_next = f(x, u)."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from statebook import _validate, rates
from statebook.models.base import Model
from statebook.probes import (
    arguments_of,
    copied,
    depends_on_time,
    number_of_inputs,
    require_pure,
    spread_beside,
    takes_batches,
)


@dataclass(frozen=True)
class System:
    """A state-space system with labels and a timebase.

    It pickles where its function does: one defined with def at the top of a module, not a lambda
    (which cloudpickle takes).

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
    batched : bool
        Its rate takes a batch of states.
    timed : bool
        Its rate has a time among its arguments; whether it depends on it, time_of finds out.
    """

    rate: Callable[[Any, Any, float], Any] = field(repr=False)
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    dt: float | bool | None = None
    linear: bool = False
    name: str = "system"
    source: Any = field(default=None, repr=False)
    batched: bool = True
    timed: bool = False

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
            Time, for a system that depends on it.

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

    def probe(self, x: np.ndarray, u: np.ndarray, t: float = 0.0) -> np.ndarray:
        """Evaluate f at a batch that may leave its domain.

        Parameters
        ----------
        x, u : array, shape (n, N) and (m, N)
            Real or complex.
        t : float [s]

        Returns
        -------
        array, shape (n, N)
            NaN in the columns where f is undefined or raises whatever it raises there.

        Raises
        ------
        ValueError
            What f returned at one state has another shape than at others.
        Exception
            Whatever f raises at a complex state: it may not know complex numbers.

        Examples
        --------
        >>> import statebook as sb
        >>> sb.as_system(lambda x: 1 / x, [1.0]).probe(np.array([[0.5, 2.0]]), np.empty((0, 2)))
        array([[2. , 0.5]])
        """
        with np.errstate(all="ignore"):
            if self.batched:
                try:
                    return np.asarray(self.rate(x, u, t))
                except Exception:  # one column's, perhaps
                    if np.iscomplexobj(x):
                        raise
            columns = []
            for column in zip(x.T, u.T, strict=True):
                try:
                    columns.append(np.asarray(self.rate(*column, t)))
                except Exception:  # math.sqrt(-1), 1 / 0, a table's end
                    if np.iscomplexobj(column[0]):
                        raise
                    columns.append(np.full(self.n, np.nan))
                if columns[-1].shape != (self.n,):
                    raise ValueError(
                        f"{self.name} must return shape {(self.n,)} everywhere, got"
                        f" {columns[-1].shape} at x = {_validate.brief(column[0])}"
                    )
            return np.stack(columns, axis=1)

    def _check(self, value: Any, x: np.ndarray) -> np.ndarray:
        try:
            return _validate.array("dynamics(x, u)", value, x.shape)
        except ValueError as error:
            raise ValueError(f"{self.name}: {error}, at x = {_validate.brief(x)}") from None


def as_system(
    system: Any,
    x0: Any = None,
    u0: Any = None,
    *,
    dt: float | bool | None = None,
    names: tuple[str, str] = ("x0", "u0"),
) -> System:
    """View anything that has dynamics as a System.

    Parameters
    ----------
    system : library model, function, control.NonlinearIOSystem or control.StateSpace
        A function is f(x), f(x, u) or f(x, u, t); it may return a column (n, 1). A System is
        returned as it is.
    x0, u0 : array, shape (n,) or (n, N) and (m,) or (m, N), optional
        An example state and input. A function needs x0 to know n; without u0 it is asked how
        many inputs it takes.
    dt : float, bool or None
        Timebase of a function. Other systems know theirs; a contradiction is refused.
    names : pair of str, optional
        What messages call x0 and u0.

    Returns
    -------
    System

    Raises
    ------
    TypeError
        The object has no dynamics.
    ValueError
        A needed x0 or u0 is missing, dt contradicts the system's own, or a function changes
        its arguments, or has a memory.

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
    if isinstance(system, type):
        raise TypeError(f"system must be an instance, got the class {system.__name__}")
    if isinstance(system, System):
        result = system
    elif hasattr(system, "to_nlsys") and hasattr(system, "dynamics"):
        result = _from_model(system)
    elif hasattr(system, "nstates") and hasattr(system, "ninputs"):
        result = _from_control(system)
    elif callable(system):
        return _from_function(system, x0, u0, dt, names)
    else:
        raise TypeError(
            "system must be a library model, a function f(x), f(x, u) or f(x, u, t), a"
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
    plain = getattr(type(model), "dynamics", None) is Model.dynamics
    # Its dynamics would check once more what System does.
    rate = model.rate if plain else partial(rates.of_model, model.dynamics)
    labels, linear = (tuple(model.states), tuple(model.inputs)), getattr(model, "linear", False)
    return System(rate, *labels, linear=linear, name=type(model).__name__, source=model)


def _from_control(sys: Any) -> System:
    import control

    rates.make_portable(control.StateSpace)
    linear = isinstance(sys, control.StateSpace)
    rate: Any
    if linear:
        rate = partial(rates.linear, np.asarray(sys.A), np.asarray(sys.B))
    elif isinstance(sys, control.NonlinearIOSystem) and sys.nstates is not None:
        rate = partial(rates.of_control, sys)
    else:
        raise TypeError(
            f"system must be in state space, got {type(sys).__name__}: convert a transfer"
            " function with control.ss() first; to frequency data a model must be fitted"
        )
    labels = tuple(sys.state_labels), tuple(sys.input_labels)
    return System(rate, *labels, sys.dt, linear, sys.name, sys, batched=linear, timed=not linear)


def _from_function(
    f: Callable[..., Any], x0: Any, u0: Any, dt: float | bool | None, names: tuple[str, str]
) -> System:
    state_name, input_name = names
    if x0 is None:
        raise ValueError(f"{state_name} is required for a function: its length tells the state's")
    x0 = _validate.vectors(state_name, x0, "n")
    if dt is not None and dt is not True:
        dt = _validate.non_negative("dt", dt)
    required, accepted = arguments_of(f)
    driven = required >= 2 or (u0 is not None and np.size(u0) > 0)
    if driven and accepted < 2:
        raise ValueError(
            f"{input_name} was given, but the function takes x alone: write it f(x, u)"
        )
    timed = driven and accepted == 3
    number = 3 if timed else 1 + driven
    rate = partial(rates.of_function, f, number)
    state = x0 if x0.ndim == 1 else x0[:, 0]
    if u0 is None and driven:
        m = number_of_inputs(lambda u: rate(state, u, 0.0), state.size)
        if m is None:
            raise ValueError(
                f"{input_name} is required for this function f(x, u): its length tells the"
                f" input's; write {input_name}=np.zeros(m)"
            )
        u0 = np.zeros(m)
    u0 = _validate.vectors(input_name, u0, "m") if u0 is not None else np.zeros(0)
    drive = u0 if u0.ndim == 1 else u0[:, 0]

    at_start = partial(rate, t=0.0)
    require_pure(lambda x, u: copied(f(*(x, u, 0.0)[:number])), (state, drive))
    columns = next(N for N in (3, 4, 5) if N not in (state.size, drive.size))
    beside = spread_beside(state, columns), spread_beside(drive, columns)
    batched = takes_batches(at_start, *beside, alone=at_start, rtol=1e-12)
    states = tuple(f"x[{i}]" for i in range(state.size))
    inputs = tuple(f"u[{i}]" for i in range(drive.size))
    name = getattr(f, "__name__", type(f).__name__).replace("<lambda>", "function")
    return System(rate, states, inputs, dt, name=name, source=f, batched=batched, timed=timed)


def time_of(system: System, x: np.ndarray, u: np.ndarray, t: float | None) -> float:
    """Return the time at which a system is to be analysed.

    Parameters
    ----------
    system : System
    x, u : array, shape (n,) and (m,)
    t : float or None [s]
        None only for a system that does not depend on the time.

    Raises
    ------
    TypeError, ValueError
        t is not a finite number, or is missing.
    """
    if t is not None:
        return _validate.number("t", t)
    if system.timed and depends_on_time(system.rate, x, u):
        raise ValueError(
            f"t is required: {system.name} depends on the time, so that this analysis holds for"
            " one time only; write t=0.0, say"
        )
    return 0.0


Output = Callable[[np.ndarray, np.ndarray, float], np.ndarray]


def output_map(system: System) -> tuple[tuple[str, ...], Output | None]:
    """Return the labels of a system's outputs and their function.

    Returns
    -------
    labels : tuple of str
    output : callable or None
        Maps batches x (n, N), u (m, N) and a time to (p, N). None if the system has no
        outputs of its own; they are its states then.
    """
    sys = system.source
    if not hasattr(sys, "output_labels"):
        return system.states, None

    def output(x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
        columns = [np.array(sys.output(t, *column)) for column in zip(x.T, u.T, strict=True)]
        return np.stack(columns, axis=1)

    return tuple(sys.output_labels), output
