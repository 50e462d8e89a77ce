"""Many trajectories of one system under independent errors."""

from __future__ import annotations

from typing import Any

import numpy as np

from statebook import _validate
from statebook.control_trajectory import ControlTrajectory
from statebook.policies import as_plan, at_start
from statebook.simulation import simulate_clocked
from statebook.systems import System, as_system
from statebook.trajectory import Trajectory
from statebook.uncertainty.error_models import control_of, with_disturbance
from statebook.uncertainty.noise import HeldNoise


def monte_carlo(
    system: Any,
    x0: Any,
    policy: Any = None,
    *,
    number: int,
    period: float,
    duration: float,
    disturbance: Any = None,
    G: Any = None,
    samples: int = 1,
    method: str = "RK45",
    rtol: float = 1e-8,
    atol: float = 1e-10,
) -> Trajectory:
    """Simulate many trajectories under independent errors.

    At each tick the policy, with the errors wrapped round it, sees the states; its controls and
    the disturbance are held until the next tick, so that the solver meets no jump.

    Parameters
    ----------
    system : system
        Whatever as_system takes, with or without inputs. In discrete time the period is its
        sample time.
    x0 : array, shape (n,) or (n, N)
        One initial state for all, or one a trajectory.
    policy : callable, array (m,) or ControlTrajectory, optional
        u(x, t) for batches (n, N), or what is held; zero if omitted. Wrapped in
        `with_measurement_error` and `with_actuation_error` where it meets such errors.
    number : int > 0
        N, the number of trajectories.
    period : float > 0 [s]
        Of the clock.
    duration : float > 0 [s]
        Rounded up to whole periods.
    disturbance : HeldNoise or callable, optional
        w in x' = f(x, u) + G w; a function w(x, t) returns (q,) or (q, N). White noise needs
        the period of the clock, so that none of it is skipped.
    G : array, shape (n, q), optional
        Where the disturbance enters; the identity if omitted.
    samples : int > 0
        Stored samples a period.
    method : str
        As in simulate; "rk4" and "euler" make one step a sample.
    rtol, atol : float > 0
        As in simulate.

    Returns
    -------
    Trajectory
        States (n, N, T) and the inputs (u, w) that acted, one an interval.

    Raises
    ------
    DivergenceError
        As simulate.
    TypeError, ValueError
        An argument has the wrong type or shape, or the noise is held for less than a period or
        for a fraction of one.

    Examples
    --------
    >>> import statebook as sb
    >>> gusts = sb.HeldNoise.white(0.5, 0.1, seed=1)
    >>> run = sb.monte_carlo(sb.Particle(m=2.0), [0, 0], number=400, period=0.1, duration=3.0,
    ...                      disturbance=gusts, G=[[0], [0.5]])
    >>> run
    Trajectory(a batch of 400, n=2, m=2, 31 times over [0, 3] s)
    >>> sb.consistency(run.states[:1, :, -1], 0.5 * 3.0**3 / 3 / 2.0**2) > 1e-8
    True
    """
    number = _validate.integer("number", number, 1)
    period = _validate.positive("period", period)
    duration = _validate.positive("duration", duration)
    samples = _validate.integer("samples", samples, 1)
    x0 = _validate.real_array("x0", x0)
    if x0.ndim not in (1, 2) or (x0.ndim == 2 and x0.shape[1] != number):
        raise ValueError(f"x0 must have shape (n,) or (n, {number}), got {x0.shape}")
    start = x0.copy() if x0.ndim == 2 else np.repeat(x0[:, None], number, axis=1)
    policy = as_plan("policy", policy)
    asked = callable(policy) and not isinstance(policy, ControlTrajectory)
    first = [at_start("policy(x0, 0)", policy, start, 0.0)] if asked else []
    system = _viewed(system, start, first[0] if asked else policy, asked)
    if policy is not None and not system.m:
        raise ValueError(f"policy must be left out: {system.name} has no inputs")
    m = system.m
    if disturbance is None:
        if G is not None:
            raise ValueError("G was given without a disturbance: give both, or neither")
        disturbed, q = system, 0
    else:
        disturbed = with_disturbance(system, G)
        q = disturbed.m - m
        if isinstance(disturbance, HeldNoise):
            _check_noise(disturbance, period, q)

    def inputs(x: np.ndarray, t: float) -> np.ndarray:
        # One call a tick: the first told how many inputs there are.
        now = first.pop() if first else policy
        u = np.zeros((m, number)) if policy is None else control_of(now, x, t, m)
        if disturbance is None:
            return u
        held = isinstance(disturbance, HeldNoise)
        w = disturbance(t, number) if held else control_of(disturbance, x, t, q, "disturbance")
        return np.concatenate([u, w])

    options: dict[str, Any] = {"method": method, "rtol": rtol, "atol": atol, "samples": samples}
    return simulate_clocked(disturbed, start, inputs, period=period, duration=duration, **options)


def _viewed(system: Any, start: np.ndarray, value: Any, asked: bool) -> System:
    """Return the system; of a plain function, the states and a control tell n and m."""
    x, u = start[:, 0], None
    if isinstance(value, ControlTrajectory):
        u = np.zeros(value.m)
    elif value is not None:
        # One number a trajectory is a single input.
        single = np.ndim(value) == 0 or (asked and value.shape == start.shape[1:])
        u = np.zeros(1 if single else len(value))
    return as_system(system, x, u, names=("x0", "policy"))


def _check_noise(noise: HeldNoise, period: float, q: int) -> None:
    if noise.size != q:
        raise ValueError(
            f"disturbance must have the {q} components that G has columns, got {noise.size}"
        )
    ratio = noise.period / period
    if round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
        raise ValueError(
            f"disturbance must be held for a whole number of periods of {period:g} s, got "
            f"{noise.period:g} s: what a clock skips or cuts has another variance"
        )
