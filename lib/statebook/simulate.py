"""Simulation: the trajectory of a system from an initial state under a control."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook._policy import Policy, as_policy, first_control, segments
from statebook.control_trajectory import ControlTrajectory, increasing
from statebook.errors import DivergenceError
from statebook.integrate import step_of
from statebook.runge_kutta import METHODS, SEMI_IMPLICIT_EULER
from statebook.systems import System, as_system
from statebook.trajectory import Trajectory

_SOLVERS = ("RK45", "RK23", "DOP853", "Radau", "BDF", "LSODA")
_FIXED_STEP = (*METHODS, SEMI_IMPLICIT_EULER)
_SAMPLES = 201
_SMALLEST_RTOL = 100 * np.finfo(float).eps  # SciPy's own limit
_CHECK_EVERY = 10_000  # steps
_HOPELESS = 1e8  # steps


def simulate(
    system: Any,
    x0: Any,
    u: Any = None,
    *,
    duration: float | None = None,
    times: Any = None,
    method: str = "RK45",
    rtol: float = 1e-8,
    atol: float = 1e-10,
) -> Trajectory:
    """Simulate a system from an initial state under a control.

    Continuous time is integrated by a SciPy solver with error control, started anew at each
    breakpoint of a control trajectory, or by fixed steps. Discrete time iterates the map.

    Parameters
    ----------
    system : library model, function f(x, u) or f(x), control.NonlinearIOSystem or StateSpace
        Anything `as_system` takes.
    x0 : array, shape (n,) or (n, N)
        Initial state, or a batch of them; each is as accurate as if it ran alone.
    u : None, number, array, function or control trajectory, optional
        None is zero; a number or an array (m,) or (m, N) is held; a policy ``u(x, t)`` returns
        a number (m = 1), (m,), or (m, N) for a batch; a `ControlTrajectory` or a SciPy PPoly.
    duration : float > 0 [s], optional
        Time to simulate, from 0: 201 uniform samples, or every sample of a discrete system.
        Only for a control trajectory it may be left out together with times: its own span.
    times : array, shape (T,), increasing [s], optional
        Instead of duration: the times wanted; x0 is the state at the first. In discrete time
        they are whole samples apart.
    method : str
        "RK45", "RK23", "DOP853", or for stiff systems "Radau", "BDF", "LSODA". Or a name in
        `METHODS` or "semi_implicit_euler": one step from each time to the next (or breakpoint),
        and times are required. Ignored in discrete time.
    rtol, atol : float > 0
        Relative and absolute tolerance of each state's error in a step of a SciPy solver.

    Returns
    -------
    Trajectory
        States (n, T) or (n, N, T) and one control per time (at a breakpoint, the later one).

    Raises
    ------
    DivergenceError
        The state leaves the finite numbers, or the solver can go no further; it holds
        ``.time``, ``.state`` and ``.trajectory``, the samples computed until then.
    TypeError, ValueError
        An argument, or what the system or the policy returns, has the wrong type or shape.

    References
    ----------
    Hairer, Norsett and Wanner, *Solving Ordinary Differential Equations I*, section II.4.

    Examples
    --------
    >>> trajectory = simulate(lambda x: -x, [1.0], duration=1.0)
    >>> trajectory
    Trajectory(n=1, m=0, 201 times over [0, 1] s)
    >>> round(trajectory.states[0, -1] * np.exp(1), 7)
    np.float64(1.0)
    """
    x0 = _validate.real_array("x0", x0)
    if x0.ndim not in (1, 2) or x0.size == 0:
        raise ValueError(f"x0 must have shape (n,) or (n, N), got {x0.shape}")
    if isinstance(u, scipy.interpolate.PPoly):
        u = ControlTrajectory.from_ppoly(u)
    given = None if times is None else increasing("times", times, minimum=1)
    start = given[0] if given is not None else 0.0
    if given is None and duration is None and isinstance(u, ControlTrajectory):
        start, duration = u.breakpoints[0], u.duration
    first_state = x0 if x0.ndim == 1 else x0[:, 0]
    system = as_system(system, x0, _first_control(u, first_state, start))
    if system.n != len(x0):
        raise ValueError(f"x0 must have n = {system.n} rows for {system.name}, got {x0.shape}")
    _validate.choice("method", method, _SOLVERS + _FIXED_STEP)
    if method in _FIXED_STEP and given is None and not system.discrete:
        raise ValueError(f'method "{method}" steps from time to time: give times, not duration')
    times = _times(given, duration, start, system)
    policy = as_policy(u, system.m, x0, times[0])
    stretches = _stretches(u, policy, times)
    _check_dynamics(system, x0, policy(x0, times[0]), times[0])
    flow = _Flow(system)
    if system.discrete:
        samples = _iterate(flow, x0, policy, times)
    elif method in _FIXED_STEP:
        samples = _fixed_steps(flow, x0, stretches, times, method)
    else:
        rtol, atol = _validate.positive("rtol", rtol), _validate.positive("atol", atol)
        samples = _adaptive_steps(flow, x0, stretches, times, method, rtol, atol)

    states = [x0]
    with np.errstate(all="ignore"):
        try:
            states.extend(samples)
        except _Stopped as stop:
