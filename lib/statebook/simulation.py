"""Simulation: a system from an initial state under a control, or under a clock."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy

from statebook import _validate
from statebook.control_trajectory import ControlTrajectory
from statebook.errors import DivergenceError
from statebook.policies import Policy, as_policy, first_control, segments
from statebook.runge_kutta import METHODS, SEMI_IMPLICIT_EULER
from statebook.stepping import SOLVERS, Flow, StoppedError, adaptive_steps, fixed_steps, iterate
from statebook.systems import System, as_system
from statebook.times import increasing
from statebook.trajectory import Trajectory

_FIXED_STEP = (*METHODS, SEMI_IMPLICIT_EULER)
_SAMPLES = 201


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
    system = as_system(system, x0, first_control(u, first_state, start))
    if system.n != len(x0):
        raise ValueError(f"x0 must have n = {system.n} rows for {system.name}, got {x0.shape}")
    _validate.choice("method", method, SOLVERS + _FIXED_STEP)
    if method in _FIXED_STEP and given is None and not system.discrete:
        raise ValueError(f'method "{method}" steps from time to time: give times, not duration')
    times = _times(given, duration, start, system)
    if isinstance(u, ControlTrajectory):
        _check_span(u, times)
    policy = as_policy(u, system.m, x0, times[0])
    _check_start(system, x0, policy(x0, times[0]), times[0])
    flow = Flow(system)
    stretches = segments(u, policy, times[0], times[-1])
    if system.discrete:
        samples = iterate(flow, x0, policy, times, float(system.dt or 0))
    elif method in _FIXED_STEP:
        samples = fixed_steps(flow, x0, stretches, times, method)
    else:
        tolerances = _validate.positive("rtol", rtol), _validate.positive("atol", atol)
        samples = adaptive_steps(flow, x0, stretches, times, method, *tolerances)

    states = [x0]
    with np.errstate(all="ignore"):  # an overflow is reported as the divergence it is
        try:
            for state in samples:
                states.append(state)
        except StoppedError as stop:
            known = _trajectory(system, times[: len(states)], states, policy, partial=True)
            raise DivergenceError(
                f"simulation of {system.name} stopped at t = {stop.time:.6g}, x = "
                f"{np.array2string(stop.state, precision=4, threshold=8)}: {stop}; "
                f"{len(states)} of {len(times)} samples are in .trajectory",
                time=stop.time,
                state=stop.state,
                trajectory=known,
            ) from None
        return _trajectory(system, times, states, policy)


def _times(given: np.ndarray | None, duration: Any, start: float, system: System) -> np.ndarray:
    if (given is None) == (duration is None):
        raise ValueError("give either duration or times" + (", not both" if duration else ""))
    if given is None:
        duration = _validate.positive("duration", duration)
    if not system.discrete:
        return np.linspace(start, start + duration, _SAMPLES) if given is None else given
    dt = float(system.dt or 1)
    spans = np.array([duration]) if given is None else given - start
    counts = np.round(spans / dt)
    if np.any(np.abs(spans - counts * dt) > 1e-9 * np.maximum(dt, np.abs(spans))):
        name = "duration" if given is None else "times"
        raise ValueError(
            f"{name} must be whole samples of dt = {dt:g} apart, got {duration or given}"
        )
    return start + dt * np.arange(counts[0] + 1) if given is None else given


def _check_span(u: ControlTrajectory, times: np.ndarray) -> None:
    start, end = u.breakpoints[[0, -1]]
    slack = 1e-12 * max(np.abs(times[[0, -1]]).max(), end - start)
    if times[0] < start - slack or times[-1] > end + slack:
        raise ValueError(
            f"u must cover the simulated times [{times[0]:g}, {times[-1]:g}], "
            f"got a control trajectory over [{start:g}, {end:g}]"
        )


def _check_start(system: System, x0: np.ndarray, u: np.ndarray, t: float) -> None:
    _validate.array("u(x0, t0)", u)
    with np.errstate(all="ignore"):
        if np.iscomplexobj(system.dynamics(x0, u, float(t))):
            raise TypeError(f"{system.name} must return real numbers for real x, got complex ones")


def _trajectory(
    system: System,
    times: np.ndarray,
    states: list[np.ndarray],
    policy: Policy,
    *,
    partial: bool = False,
) -> Trajectory:
    controls = None
    if system.m:
        values = [policy(x, float(t)) for x, t in zip(states, times, strict=True)]
        controls = np.stack(values, axis=-1)
        if partial and not np.isfinite(controls).all():
            controls = None  # the control is what stopped the simulation
    return Trajectory(
        times,
        np.stack(states, axis=-1),
        controls,
        state_labels=system.states,
        input_labels=None if controls is None else system.inputs,
    )


def simulate_clocked(
    system: Any,
    x0: Any,
    policy: Callable[[np.ndarray, float], Any],
    *,
    period: float,
    duration: float,
    samples: int = 4,
    **options: Any,
) -> Trajectory:
    """Simulate a continuous plant under a sampled controller.

    At each tick t_k = k period the policy sees x(t_k); its control is held until the next.

    Parameters
    ----------
    system : system
        Whatever as_system takes; a function f(x, u) too.
    x0 : array, shape (n,) or (n, N)
    policy : callable
        u(x, t), called once a tick, in order of time, so that it may have a memory.
    period : float > 0 [s]
    duration : float > 0 [s]
        Rounded up to whole periods.
    samples : int > 0
        Stored samples a period.
    **options
        method, rtol and atol of simulate.

    Returns
    -------
    Trajectory
        With one control an interval.

    Raises
    ------
    DivergenceError
        As simulate.
    TypeError, ValueError
        An argument, or what the policy returns, has the wrong type or shape.

    Examples
    --------
    >>> import statebook as sb
    >>> plant, x0 = sb.Particle(), [1.0, 0.0]
    >>> run = simulate_clocked(plant, x0, lambda x, t: -x[:1], period=0.5, duration=1)
    >>> run.states[:, -1].round(6)
    array([ 0.515625, -0.9375  ])
    """
    period = _validate.positive("period", period)
    duration = _validate.positive("duration", duration)
    samples = _validate.integer("samples", samples, 1)
    x = _validate.real_array("x0", x0)
    ticks = int(np.ceil(duration / period * (1 - 1e-12)))
    system = as_system(system, x, np.atleast_1d(policy(x, 0.0)))
    states, controls = [x[..., None]], []
    for k in range(ticks):
        u = _validate.real_array("policy(x, t)", policy(x, k * period))
        times = np.linspace(k, k + 1, samples + 1) * period
        piece = simulate(system, x, u, times=times, **options)
        states.append(piece.states[..., 1:])
        controls.append(np.asarray(piece.controls)[..., 1:])
        x = piece.states[..., -1]
    return Trajectory(
        np.arange(ticks * samples + 1) * (period / samples),
        np.concatenate(states, axis=-1),
        np.concatenate(controls, axis=-1),
    )
