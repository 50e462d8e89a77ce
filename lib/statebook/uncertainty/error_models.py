"""Errors wrapped round systems and policies; `monte_carlo` runs them."""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from statebook import _validate
from statebook.control_trajectory import ControlTrajectory
from statebook.policies import Policy, shaped
from statebook.systems import System, as_system
from statebook.uncertainty.noise import HeldNoise


def with_disturbance(system: Any, G: Any = None) -> System:
    """Give a system the disturbance w as further inputs.

    x' = f(x, u) + G w, or x_next = f(x, u) + G w in discrete time.

    Parameters
    ----------
    system : library model, System, control.NonlinearIOSystem or StateSpace
        For a function f(x, u) call as_system first.
    G : array, shape (n, q), optional
        Where w enters; the identity if omitted, so that q = n.

    Returns
    -------
    System
        With the inputs (u, w), those of w labelled w[0], w[1], ...

    Raises
    ------
    TypeError, ValueError
        The system has no dynamics, or G another number of rows.

    Examples
    --------
    >>> import statebook as sb
    >>> gusty = with_disturbance(sb.Particle(m=2.0), G=[[0.0], [0.5]])
    >>> gusty.dynamics([0.0, 1.0], [4.0, -1.0])
    array([1. , 1.5])
    """
    system = as_system(system)
    n = system.n
    G = np.eye(n) if G is None else _validate.real_array("G", G, (n, None))

    inputs = (*system.inputs, *(f"w[{i}]" for i in range(G.shape[1])))
    name, rate = f"{system.name} with disturbance", partial(_pushed, system, G)
    return replace(system, rate=rate, inputs=inputs, name=name, source=system, batched=True)


def with_actuation_error(policy: Policy, noise: HeldNoise, *, gain: Any = 1.0) -> Policy:
    """A policy whose controls are not executed faithfully.

    What acts is gain u + w(t), w the noise with its bias.

    Parameters
    ----------
    policy : callable
        u(x, t), which takes a batch (n, N) and returns (m,) or (m, N); or a ControlTrajectory.
    noise : HeldNoise, q = m
    gain : float or array, shape (m, m), optional
        1 is a faithful actuator.

    Returns
    -------
    callable
        A policy for batches (n, N).

    Raises
    ------
    TypeError, ValueError
        The noise is none, or has another size than the controls.

    Examples
    --------
    >>> exact = HeldNoise(0.0, 0.1, seed=1)
    >>> policy = with_actuation_error(lambda x, t: -3 * x[:1], exact, gain=0.5)
    >>> policy(np.array([[2.0, 4.0], [0.0, 0.0]]), 0.0)
    array([[-3., -6.]])
    """
    noise = _validate.instance("noise", noise, HeldNoise)
    m = noise.size
    gain = _validate.real_array("gain", gain)
    if gain.shape not in ((), (m, m)):
        raise ValueError(f"gain must be a number or have shape ({m}, {m}), got {gain.shape}")
    return partial(_acting, policy, noise, gain if gain.ndim else gain * np.eye(m))


def with_measurement_error(policy: Policy, noise: HeldNoise) -> Policy:
    """A policy that sees x + w(t) instead of the state x.

    Parameters
    ----------
    policy : callable
        u(x, t); takes a batch (n, N).
    noise : HeldNoise, q = n

    Returns
    -------
    callable
        A policy for batches (n, N).

    Raises
    ------
    TypeError, ValueError
        The noise is none, or has another size than the state.

    Examples
    --------
    >>> noise = HeldNoise(np.zeros((2, 2)), 0.1, seed=1, bias=[0.5, 0.0])
    >>> with_measurement_error(lambda x, t: -3 * x[:1], noise)(np.zeros((2, 1)), 0.0)
    array([[-1.5]])
    """
    return partial(_misled, policy, _validate.instance("noise", noise, HeldNoise))


def with_parameters(model: Any, names: Sequence[str]) -> System:
    """Make parameters of a model further states, which do not change.

    (x, p)' = (f(x, u; p), 0): an error in a parameter is an error in the state.

    Parameters
    ----------
    model : library model
        A frozen dataclass with ``dynamics(x, u)``; its own values of these parameters are unused.
    names : sequence of str
        Fields of the model that are single numbers, for example ("m",).

    Returns
    -------
    System
        With the states (x, p).

    Raises
    ------
    TypeError, ValueError
        The model has no such parameter; in the state, a parameter is out of the model's range.

    Examples
    --------
    >>> import statebook as sb
    >>> with_parameters(sb.Particle(), ["m"]).dynamics([0.0, 3.0, 2.0], [8.0])
    array([3., 4., 0.])
    """
    if not is_dataclass(model) or isinstance(model, type):
        raise TypeError(f"model must be a library model, got {model!r}")
    if isinstance(names, str) or not names:
        raise TypeError(f"names must be a sequence of parameter names, got {names!r}")
    known = [f.name for f in fields(model) if isinstance(getattr(model, f.name), float)]
    for name in names:
        _validate.choice("names", name, known)
    system = as_system(model)
    rate, states = partial(_with_values, model, tuple(names)), (*system.states, *names)
    return System(rate, states, system.inputs, name=f"{system.name} with parameters", source=model)


# Of modules rather than closures, so that what is made of them pickles.


def _pushed(system: System, G: np.ndarray, x: np.ndarray, u: np.ndarray, t: float) -> np.ndarray:
    m = system.m
    push = G @ u[m:]
    return system.dynamics(x, u[:m], t) + (push[:, None] if x.ndim > push.ndim else push)


def _acting(
    policy: Policy, noise: HeldNoise, gain: np.ndarray, x: np.ndarray, t: float
) -> np.ndarray:
    number = _batch("with_actuation_error", x)
    return gain @ control_of(policy, x, t, noise.size) + noise(t, number)


def _misled(policy: Policy, noise: HeldNoise, x: np.ndarray, t: float) -> Any:
    number = _batch("with_measurement_error", x)
    if len(x) != noise.size:
        raise ValueError(
            f"noise must have the size of the state, {len(x)}, got {noise.size}: "
            "a state that is seen exactly has a covariance of 0"
        )
    return policy(x + noise(t, number), t)


def _with_values(
    model: Any, names: tuple[str, ...], x: np.ndarray, u: np.ndarray, t: float
) -> np.ndarray:
    n = len(x) - len(names)
    values = dict(zip(names, x[n:], strict=True))
    # The smallest values meet the model's own checks, then each becomes the array of a batch.
    lowest = {name: float(np.min(np.real(value))) for name, value in values.items()}
    variant: Any = replace(model, **lowest)
    for name, value in values.items():
        object.__setattr__(variant, name, value)
    return np.concatenate([variant.dynamics(x[:n], u), 0 * x[n:]])


def control_of(policy: Any, x: np.ndarray, t: float, m: int, name: str = "policy") -> np.ndarray:
    """Return a policy's, plan's or constant's controls for a batch (n, N), as (m, N)."""
    if isinstance(policy, ControlTrajectory):
        policy = policy(t)
    value = _validate.real_array(f"{name}(x, t)", policy(x, t) if callable(policy) else policy)
    return shaped(f"{name}(x, t)", value[:, 0] if value.shape == (m, 1) else value, m, x.shape[1:])


def _batch(name: str, x: np.ndarray) -> int:
    # A single state does not tell which trajectory it belongs to, and a solver that asks for
    # columns one by one would give all of them the noise of the first.
    if np.ndim(x) != 2:
        raise ValueError(
            f"{name} needs a batch of states (n, N), one column a trajectory, got shape "
            f"{np.shape(x)}: run it with monte_carlo"
        )
    return x.shape[1]
