"""Simulation: a system from an initial state under a control, or under a clock."""

from dataclasses import replace
from typing import Any

import numpy as np

from statebook import _validate
from statebook.clock import Clock
from statebook.control_trajectory import ControlTrajectory
from statebook.dense_output import Steps
from statebook.events import watches
from statebook.policies import Policy, as_control, as_plan, at_start, example_input, shaped, valued
from statebook.probes import takes_batches
from statebook.runge_kutta import METHODS, SEMI_IMPLICIT_EULER
from statebook.runs import may_vary, through
from statebook.solvers import SOLVERS
from statebook.stepping import Flow, Solver
from statebook.systems import System, as_system
from statebook.times import increasing, tick, whole_samples
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
    method: str | None = None,
    rtol: float = 1e-8,
    atol: Any = 1e-10,
    max_step: float | None = None,
    max_steps: float | None = None,
    switches: Any = (),
    events: Any = None,
    delay: float = 0.0,
    u_before: Any = None,
) -> Trajectory:
    """Simulate a system from an initial state under a control.

    Continuous time is integrated by a SciPy solver with error control, started anew at each
    switch of the control, or by fixed steps. Discrete time iterates the map.

    Parameters
    ----------
    system : library model, function f(x, u) or f(x), control.NonlinearIOSystem or StateSpace
        Anything `as_system` takes.
    x0 : array, shape (n,) or (n, N)
        Initial state, or a batch of them; each is as accurate as if it ran alone.
    u : None, number, array, function or control trajectory, optional
        None is zero; a number or an array (m,) or (m, N) is held; a policy ``u(x, t)`` returns
        a number (m = 1), (m,), or (m, N) for a batch; a `ControlTrajectory` or a SciPy PPoly.
        An array (m, T), or (T,) for m = 1, beside T times is sampled there, and linear in
        between, as in python-control and `scipy.signal.lsim`; where both readings fit it is held.
    duration : float > 0 [s], optional
        Time to simulate, from 0: 201 uniform samples, or every sample of a discrete system.
        Only for a control trajectory it may be left out together with times: its own span.
    times : array, shape (T,), increasing [s], optional
        Instead of duration: the times wanted; x0 is the state at the first. In discrete time
        they are whole samples apart.
    method : str, optional
        "RK45", "RK23", "DOP853", or for stiff systems "Radau", "BDF", "LSODA". Or a name in
        `METHODS` or "semi_implicit_euler": one step from each time to the next (or breakpoint),
        and times are required. By default "RK45"; "DOP853" for a batch under no policy, whose
        steps may be long. Ignored in discrete time.
    rtol : float > 0
        Relative tolerance of each state's error in a step of a SciPy solver.
    atol : float > 0 or array, shape (n,)
        Absolute tolerance, in the units of the states.
    max_step : float > 0 [s], optional
        Longest step of a SciPy solver. By default, under a policy or for a system that may vary
        with time, the distance of the times wanted: no jump that lasts longer is stepped over.
        For shorter pulses give max_step, or their times as switches.
    max_steps : float > 0, optional
        Give up where a run would need more steps (looked at every 5,000); np.inf never does.
        By default it gives up where steps collapse, and more than 1e6 to come are announced.
    switches : array, shape (K,) [s]
        Times at which a policy or the system jumps: the solver is started anew there.
    events : function, list or dict of functions, optional
        As in SciPy, functions e(x, t), or e(t, y), that pass zero at an event, with attributes
        ``terminal`` (bool or count) and ``direction``; looked at in each step and sample. What
        they found, with the dict's keys or the functions' names, is in ``.events``; a terminal
        event ends the trajectory.
    delay : float >= 0 [s]
        Input delay: the control at t is that of t - delay. Exact: the past is the solver's own.
    u_before : number or array, shape (m,) or (m, N), optional
        The control that acts until the delay has passed; None is zero.

    Returns
    -------
    Trajectory
        States (n, T) or (n, N, T) and one control per time (at a breakpoint, the later one),
        with the solver's dense output between them.

    Raises
    ------
    DivergenceError
        The state leaves the finite numbers, or the solver can go no further; it holds
        ``.time``, ``.state`` and ``.trajectory``, the samples computed until then.
    TypeError, ValueError
        An argument, or what the system or the policy returns, has the wrong type or shape.

    Warns
    -----
    UserWarning
        A control returned at a sample is not one that the motion felt: a pulse was stepped over.

    References
    ----------
    Hairer, Norsett and Wanner, *Solving Ordinary Differential Equations I*, sections II.4 and
    II.17 (delays).

    Examples
    --------
    >>> trajectory = simulate(lambda x: -x, [1.0], duration=1.0)
    >>> trajectory
    Trajectory(n=1, m=0, 201 times over [0, 1] s)
    >>> round(trajectory.states[0, -1] * np.exp(1), 7)
    np.float64(1.0)
    """
    x0 = _state(x0)
    u = as_plan("u", u)
    given = None if times is None else increasing("times", times, minimum=1)
    start = float(given[0]) if given is not None else 0.0
    if given is None and duration is None and isinstance(u, ControlTrajectory):
        start, duration = float(u.breakpoints[0]), u.duration
    known = _as_system(system, x0, example_input(system, u, x0, start, given), start)
    if method is None:
        method = "RK45" if x0.ndim == 1 or callable(u) else "DOP853"
    solver = _solver(method, rtol, atol, max_step, max_steps, len(x0))
    if method in _FIXED_STEP and given is None and not known.discrete:
        raise ValueError(f'method "{method}" steps from time to time: give times, not duration')
    times = _times(given, duration, start, known)
    control = as_control(u, known, x0, times, None if given is None else times)
    before = _control("u_before", u_before, known.m, x0.shape[1:])
    delay = _validate.non_negative("delay", delay)
    switches = np.union1d(_validate.real_array("switches", switches, (None,)), [])
    first = before if delay else at_start("u(x0, t0)", control.policy, x0, start)
    known = _checked(known, solver, events, x0, first, start)
    steps = Steps(x0, times, by_rows=solver.by_rows, all_kept=delay > 0)
    if known.discrete:
        whole_samples("delay", delay, known.dt, f", got {delay:g}")
        return _iterated(known, steps, solver, control.policy, delay, before)
    end = float(times[-1])
    if delay > 1e-11 * (end - start):  # below, it is lost in the rounding of t
        if method in _FIXED_STEP:
            raise ValueError(f'delay needs a solver with error control, got method "{method}"')
        control, marks = control.delayed(delay, before, switches, steps)
        switches = np.union1d(switches, marks)
        if control.is_policy:  # the past must be known
            solver.max_step = min(solver.max_step, delay)
    if max_step is None and (control.is_policy or may_vary(known)):
        switches = np.union1d(switches, solver.stay_within(times))
    stretches = control.stretches(start, end, switches) if end > start else ()
    return through(Flow(known, x0), steps, solver, stretches, lambda: control)


def simulate_clocked(
    system: Any,
    x0: Any,
    policy: Any,
    *,
    period: float,
    duration: float,
    samples: int = 4,
    delay: float = 0.0,
    u_before: Any = None,
    method: str = "RK45",
    rtol: float = 1e-8,
    atol: Any = 1e-10,
    max_step: float | None = None,
    max_steps: float | None = None,
    events: Any = None,
) -> Trajectory:
    """Simulate a plant under a sampled controller.

    At each tick t_k = k period the policy sees x(t_k); its control is held until the next.

    Parameters
    ----------
    system : system
        Whatever as_system takes; a function f(x, u) too.
    x0 : array, shape (n,) or (n, N)
    policy : callable, number, array or ControlTrajectory
        u(x, t), called once a tick, in order of time, so that it may have a memory; it sees a
        batch as a whole and returns (m,), (m, N), or (N,) for m = 1. A control trajectory is
        sampled at the ticks.
    period : float > 0 [s]
    duration : float > 0 [s]
        Rounded up to whole periods.
    samples : int > 0
        Stored samples a period.
    delay : float >= 0 [s]
        Time to compute: the control of t_k acts from t_k + delay on. Whole or part periods.
    u_before : number or array, shape (m,) or (m, N), optional
        The control that acts until the first arrives; None is zero.
    method, rtol, atol, max_step, max_steps, events
        As in simulate; a method of fixed steps makes one a sample.

    Returns
    -------
    Trajectory
        With one control an interval, that of its start; `control_at` knows when it changes.

    Raises
    ------
    DivergenceError
        As simulate; its trajectory is the whole run until then.
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
    delay = _validate.non_negative("delay", delay)
    x0, policy = _state(x0), as_plan("policy", policy)
    solver = _solver(method, rtol, atol, max_step, max_steps, len(x0))
    count = int(np.ceil(duration / period * (1 - 1e-12)))

    def asked(x: np.ndarray, t: float) -> Any:
        if isinstance(policy, ControlTrajectory):
            return policy(t)
        return policy(x.copy(), t) if callable(policy) else policy

    first = at_start("policy(x0, 0)", asked, x0, 0.0)
    alone = first.ndim == 1 and first.shape == x0.shape[1:] and first.size > 1
    known = _as_system(system, x0, first[:1] if alone else np.atleast_1d(first), 0.0)
    m, batch = known.m, x0.shape[1:]
    before = _control("u_before", u_before, m, batch)

    def command(x: np.ndarray, t: float) -> np.ndarray:
        return shaped("policy(x, t)", asked(x, t), m, batch).copy()

    ticks = [tick(0.0, period, k) for k in range(count + 1)]
    clock = Clock(command, ticks, delay, before, shaped("policy(x, t)", first, m, batch))
    known = _checked(known, solver, events, x0, clock.sample(x0, 0.0), 0.0)
    times = np.array([tick(0.0, period / samples, k) for k in range(count * samples + 1)])
    times[::samples] = ticks
    steps = Steps(x0, times, by_rows=solver.by_rows)
    if known.discrete:
        whole_samples("period / samples", period / samples, known.dt, f", got {period / samples:g}")
        return _iterated(known, steps, solver, clock.sample, 0.0, before, per_interval=True)
    if max_step is None and may_vary(known):
        solver.stay_within(times)
    flow = Flow(known, x0)
    stretches = clock.stretches(flow.control, steps)
    return through(flow, steps, solver, stretches, clock.control, per_interval=True)


def _iterated(
    system: System,
    steps: Steps,
    solver: Solver,
    policy: Policy,
    delay: float,
    before: np.ndarray,
    *,
    per_interval: bool = False,
) -> Trajectory:
    """Run a system in discrete time: a clock holds the control for a sample."""
    start, dt = steps.time, float(system.dt or 1)
    wanted = np.round((steps.times - start) / dt).astype(int)
    ticks = [tick(start, dt, k) for k in range(wanted[-1] + 2)]
    steps.times = np.array(ticks)[wanted]
    flow = Flow(system, steps.state)
    clock = Clock(policy, ticks, delay, before)
    stretches = clock.stretches(flow.control, steps)
    return through(flow, steps, solver, stretches, clock.control, per_interval=per_interval)


def _state(x0: Any) -> np.ndarray:
    x0 = _validate.real_array("x0", x0).copy()
    if x0.ndim not in (1, 2) or x0.size == 0:
        raise ValueError(f"x0 must have shape (n,) or (n, N), got {x0.shape}")
    return x0


def _as_system(system: Any, x0: np.ndarray, u: np.ndarray | None, t: float) -> System:
    """View a system as one; errors speak of u."""
    with valued("the dynamics have", x0, t):
        known = as_system(system, x0, u, names=("x0", "u"))
    if known.n != len(x0):
        raise ValueError(f"x0 must have n = {known.n} rows for {known.name}, got {x0.shape}")
    return known


def _solver(method: str, rtol: Any, atol: Any, max_step: Any, max_steps: Any, n: int) -> Solver:
    _validate.choice("method", method, SOLVERS + _FIXED_STEP)
    atol = np.atleast_1d(_validate.real_array("atol", atol))
    if atol.shape not in ((1,), (n,)):
        raise ValueError(f"atol must be a number or have shape ({n},), got {atol.shape}")
    if np.any(atol <= 0):
        raise ValueError(f"atol must be greater than 0, got {atol.min():g}")
    longest = np.inf if max_step is None else _limit("max_step", max_step)
    most = None if max_steps is None else _limit("max_steps", max_steps)
    return Solver(method, _validate.positive("rtol", rtol), atol, longest, most)


def _limit(name: str, value: Any) -> float:
    return np.inf if value == np.inf else _validate.positive(name, value)


def _control(name: str, value: Any, m: int, batch: tuple[int, ...]) -> np.ndarray:
    value = np.zeros(m) if value is None else _validate.real_array(name, value)
    return shaped(name, value, m, batch)


def _checked(
    system: System, solver: Solver, events: Any, x0: np.ndarray, u: np.ndarray, t: float
) -> System:
    """Check the dynamics where a run starts; a plain function in all columns of a batch."""
    if events is not None and (system.discrete or solver.method in _FIXED_STEP):
        raise ValueError(f"events need continuous time and a method of {', '.join(SOLVERS)}")
    solver.events = watches(events, x0, t)
    with valued("the dynamics have", x0, t):
        value = system.dynamics(x0, u, t)
    if np.iscomplexobj(value):
        raise TypeError(f"{system.name} must return real numbers for real x, got complex ones")
    plain = callable(system.source) and not hasattr(system.source, "dynamics")
    if x0.ndim == 1 or not (plain and system.batched):
        return system

    def rate(x: np.ndarray, u: np.ndarray) -> Any:
        return system.rate(x, u, t)

    agrees = takes_batches(rate, x0, u, alone=rate, rtol=1e-12)
    return system if agrees else replace(system, batched=False)


def _times(given: np.ndarray | None, duration: Any, start: float, system: System) -> np.ndarray:
    if (given is None) == (duration is None):
        raise ValueError("give either duration or times" + (", not both" if duration else ""))
    if given is None:
        duration = _validate.positive("duration", duration)
        if not system.discrete:
            return np.linspace(start, start + duration, _SAMPLES)
        number = whole_samples("duration", duration, system.dt, f" apart, got {duration}")
        counts = np.arange(number + 1)
    elif system.discrete:
        counts = whole_samples("times", given - start, system.dt, f" apart, got {given}", 1e-6)
    else:
        return given
    return np.array([tick(start, float(system.dt or 1), k) for k in counts])
