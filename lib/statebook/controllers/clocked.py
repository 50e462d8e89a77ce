"""A controller on a clock: it sees the state, and changes the control, at ticks only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from statebook import _validate
from statebook.simulate import simulate
from statebook.systems import as_system
from statebook.trajectory import Trajectory


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
