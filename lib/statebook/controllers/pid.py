"""PD control of positions; PID control of what is measured, its memory a state."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from statebook import _validate
from statebook.controllers import feedback
from statebook.equilibrium import find_equilibrium
from statebook.errors import EquilibriumNotFoundError
from statebook.residuals import labels_among, point
from statebook.systems import System, as_system, output_map

Measurement = Callable[[np.ndarray], np.ndarray]


def at_rest_at(target: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the state (q, v) = (target, 0), and no control."""
    q = np.atleast_1d(_validate.real_array("target", target))
    return np.concatenate([q, 0 * q]), 0 * q


def held_at(system: System, target: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the state at rest at a target of the positions, and the control that holds it."""
    if not system.m or system.n != 2 * system.m:
        raise ValueError(
            f"the system must have positions, as many velocities and as many inputs,"
            f" got {system.n} states and {system.m} inputs; use LQR, or PID with outputs="
        )
    at_rest, idle = at_rest_at(_validate.real_array("target", target, (system.m,)))
    feedback.require_timeless(system, at_rest, idle)
    return at_rest, find_equilibrium(system, at_rest, fixed=system.states).u


@dataclass(frozen=True, eq=False)
class PD:
    """Proportional-derivative control of positions towards a target.

    u = u0 - kp (q - target) - kd v, clipped to the limit, where u0 holds the target.

    Parameters
    ----------
    system : system
        With states (q, v) and one input a position: Particle, Oscillator, Pendulum, PlanarArm.
    target : array, shape (m,)
        Positions to hold.
    kp, kd : float
        Gains. Those that do not make the target asymptotically stable are refused.
    limit : float > 0, optional
        Largest magnitude of each input.

    Raises
    ------
    TypeError, ValueError
        The system has another form, the gains destabilize, the limit cannot hold the target.

    References
    ----------
    K. J. Astrom and R. M. Murray, Feedback Systems, 2nd ed., chapter 11.

    Examples
    --------
    >>> import statebook as sb
    >>> PD(sb.Pendulum(), target=[0.0], kp=20.0, kd=3.0)([0.1, 0.0], 0.0).round(6)
    array([7.8])
    """

    system: Any
    target: Any
    kp: float
    kd: float
    limit: float | None = None
    u0: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        at_rest, idle = at_rest_at(self.target)
        system = as_system(self.system, at_rest, idle)  # of a plain function, they tell n and m
        kp, kd = _validate.number("kp", self.kp), _validate.number("kd", self.kd)
        at_rest, u0 = held_at(system, self.target)
        feedback.limit_of(self.limit, u0, "the target")
        vars(self).update(u0=u0, target=at_rest[: system.m])
        loop = as_system(lambda x: system.dynamics(x, self._unlimited(x)), at_rest, dt=system.dt)
        loop = replace(loop, linear=system.linear)
        feedback.require_stable(loop, at_rest, f"the gains kp = {kp:g}, kd = {kd:g}")

    def _unlimited(self, x: np.ndarray) -> np.ndarray:
        q, v = np.split(x, 2)
        u0, target = feedback.columns(self.u0, x), feedback.columns(self.target, x)
        return u0 - self.kp * (q - target) - self.kd * v

    def __call__(self, x: Any, t: float) -> np.ndarray:
        """Evaluate u(x, t), shape (m,) or (m, N)."""
        x = feedback.state_of(x, 2 * len(self.u0))
        return feedback.saturate(self._unlimited(x), self.limit)


@dataclass(frozen=True, eq=False)
class PID:
    """Proportional-integral-derivative control, its memory a state.

    u = u0 - kp e - ki z - kd d, clipped to the limit, with the error e = y - target of what is
    measured, z' = e, and d the rate of y; u0 holds the target. The law needs its memory, so it
    does not fit u(x, t): loop is the closed system. While an input is at its limit, its z does
    not grow further into it (anti-windup).

    Parameters
    ----------
    system : system
        With states (q, v) and one input a position, of which q is measured and v is its rate;
        or any system whose outputs are measured.
    target : array, shape (p,)
        Of the positions, or of the outputs.
    kp, ki, kd : number, or array of shape (m,) or (m, p)
        Gains; a number or a vector pairs each input with the output of its index.
    limit : float > 0, optional
        Largest magnitude of each input.
    outputs : sequence of str or array C of shape (p, n), optional
        What is measured: labels of states or of a python-control system's outputs, or C x. The
        outputs of a python-control system with as many outputs as inputs, if omitted.
    filter_time : float > 0 [s], optional
        Time constant Tf of the derivative: d = (y - f) / Tf with f' = d. If omitted, a tenth of
        kd / kp, and no filter where the velocities are states.
    x_guess, u_guess : array, shape (n,) and (m,), optional
        Where the search for the equilibrium begins that has the target as its outputs.

    Attributes
    ----------
    x0, u0 : array, shape (n,) and (m,)
        The equilibrium at the target.
    loop : System
        States (x, z), and f behind them if the derivative is filtered; its inputs are
        disturbances that add to the control. In discrete time z_next = z + dt e and
        f_next = y + exp(-dt / Tf) (f - y).

    Raises
    ------
    TypeError, ValueError
        No state at rest has the target as its outputs, an output depends on an input at once,
        the gains destabilize, the limit cannot hold the target.

    References
    ----------
    K. J. Astrom and R. M. Murray, Feedback Systems, 2nd ed., sections 11.4 (windup) and 11.5
    (filtered derivative).

    Examples
    --------
    >>> import statebook as sb
    >>> pid = PID(sb.Particle(m=2.0), target=[1.0], kp=6.0, ki=2.0, kd=5.0)
    >>> rest = sb.find_equilibrium(pid.loop, [0, 0, 0], [0.5])  # z carries the disturbance
    >>> rest.x.round(6) + 0.0
    array([1.  , 0.  , 0.25])
    >>> PID(sb.Particle(), [1.0], kp=6.0, ki=2.0, kd=5.0, outputs=["p"]).loop.states
    ('p', 'v', 'z1', 'f1')
    """

    system: Any
    target: Any
    kp: Any
    ki: Any
    kd: Any
    limit: float | None = None
    outputs: Any = field(default=None, kw_only=True)
    filter_time: float | None = field(default=None, kw_only=True)
    x_guess: Any = field(default=None, kw_only=True)
    u_guess: Any = field(default=None, kw_only=True)
    x0: np.ndarray = field(init=False)
    u0: np.ndarray = field(init=False)
    gains: tuple[np.ndarray, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        system, measure = self._plant
        target = np.atleast_1d(_validate.real_array("target", self.target))
        if self._measures(system):
            x0, u0 = self._equilibrium(system, target)
        else:
            x0, u0 = held_at(system, self.target)
        limit = feedback.limit_of(self.limit, u0, "the target")
        names, shape = ("kp", "ki", "kd"), (system.m, len(target))
        gains = tuple(feedback.matrix_of(name, getattr(self, name), shape) for name in names)
        filter_time = self.filter_time
        if filter_time is not None:
            _validate.positive("filter_time", filter_time)
        elif self._measures(system) and gains[2].any():
            if not gains[0].any():
                raise ValueError("filter_time is required for kd without kp: d is filtered")
            filter_time = float(np.abs(gains[2]).max() / np.abs(gains[0]).max()) / 10
        found = {"target": target, "limit": limit, "x0": x0, "u0": u0, "gains": gains}
        vars(self).update(found, filter_time=filter_time)
        loop, at_rest = self._loop(None), np.concatenate([x0, np.zeros(len(target))])
        if filter_time is not None:
            at_rest = np.concatenate([at_rest, measure(x0)])
        shown = (f"{name} = {_shown(getattr(self, name))}" for name in names)
        feedback.require_stable(loop, at_rest, f"the gains {', '.join(shown)}")

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "_plant"}

    @cached_property
    def _plant(self) -> tuple[System, Measurement]:
        """The system and what is measured of it."""
        x, u = self.x_guess, self.u_guess  # of a plain function, they tell n and m
        if x is None and self.outputs is None:
            x, u = at_rest_at(self.target)
        u = np.zeros(1) if u is None else u
        system = as_system(self.system, x, u, names=("x_guess", "u_guess"))
        return system, self._measurement(system)

    def _measures(self, system: System) -> bool:
        """Whether outputs are measured, rather than positions beside their velocities."""
        own = getattr(system.source, "output_labels", ())
        return self.outputs is not None or (len(own) == system.m and system.m > 0)

    def _measurement(self, system: System) -> Measurement:
        """The function y = h(x) of (n,) or (n, N)."""
        n, m, source = system.n, system.m, system.source
        own = list(getattr(source, "output_labels", ()))
        if not self._measures(system):
            return lambda x: x[:m]
        wanted = own if self.outputs is None else self.outputs
        labelled = np.ndim(wanted) == 1 and all(isinstance(label, str) for label in wanted)
        if not labelled or (self.outputs is not None and set(wanted) <= set(system.states)):
            C = feedback.rows_of("outputs", wanted, system.states)
            return lambda x: C @ x
        labels_among("outputs", wanted, (*system.states, *own))
        index = [own.index(label) for label in labels_among("outputs", wanted, own)]

        output: Any = output_map(system)[1]

        def measure(x: np.ndarray) -> np.ndarray:
            batch = x.reshape(n, -1)
            y = output(batch, np.zeros((m, batch.shape[1])), 0.0)[index]
            return np.asarray(y.reshape(-1, *x.shape[1:]))

        beside = np.zeros(n) if self.x_guess is None else np.asarray(self.x_guess, dtype=float)
        if (output(beside[:, None], np.ones((m, 1)), 0.0)[index, 0] != measure(beside)).any():
            raise ValueError("outputs must not depend on the inputs at once")
        if hasattr(source, "C"):
            return partial(np.matmul, np.asarray(source.C)[index])
        return measure

    def _equilibrium(self, system: System, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the state and the input at rest that have the target as their outputs."""
        n, measure = system.n, self._plant[1]
        x = np.zeros(n) if self.x_guess is None else self.x_guess
        x, u = point(system, x, self.u_guess, batch=False, names=("x_guess", "u_guess"))
        y = measure(x)
        if y.shape != target.shape:
            raise ValueError(f"target must have shape {y.shape}, got {target.shape}")
        if self.x_guess is None:  # the state nearest to 0 that has these outputs, if linear
            C = np.stack([measure(e) - y for e in np.eye(n)], axis=1)
            x = np.linalg.lstsq(C, target - y, rcond=None)[0]

        feedback.require_timeless(system, x, u)
        labels = [f"y{i + 1}" for i in range(len(target))]
        seen = SimpleNamespace(output_labels=labels, output=lambda t, x, u: measure(x))
        wanted = dict(zip(labels, target.tolist(), strict=True))
        try:
            found = find_equilibrium(replace(system, source=seen), x, u, fixed=[], outputs=wanted)
        except EquilibriumNotFoundError as error:
            raise ValueError(
                f"target cannot be held: no state of {system.name} at rest with the outputs"
                f" {target.tolist()} was found; give x_guess and u_guess near one ({error})"
            ) from error
        return found.x, found.u

    @property
    def loop(self) -> System:
        """The closed loop with its memory; its inputs are disturbances."""
        return self._loop(self.limit)

    def _loop(self, limit: float | None) -> System:
        system = self._plant[0]
        names = ("z",) if self.filter_time is None else ("z", "f")
        memories = dict.fromkeys(names, len(self.target))
        return feedback.closed_loop(system, partial(self._closed, limit), memories, "PID")

    def __call__(self, y: Any, t: float) -> np.ndarray:
        """Evaluate the control at y = (x, z) or (x, z, f), shape (m,) or (m, N)."""
        n, p = len(self.x0), len(self.target)
        y = feedback.state_of(y, n + (1 if self.filter_time is None else 2) * p)
        return self._law(y, self.limit)[0]

    def _law(self, state: np.ndarray, limit: float | None) -> tuple[np.ndarray, ...]:
        """Return the control, the error and the rate of y that it acts on."""
        n, p = len(self.x0), len(self.target)
        x, z, f = state[:n], state[n : n + p], state[n + p :]
        y = self._plant[1](x)
        u0, error = feedback.columns(self.u0, y), y - feedback.columns(self.target, y)
        rate = x[p:] if self.filter_time is None else (y - f) * self._pace()
        kp, ki, kd = self.gains
        # Without a filter and a velocity kd is 0.
        derivative = kd @ rate if kd.any() else 0.0
        return feedback.saturate(u0 - kp @ error - ki @ z - derivative, limit), error, rate

    def _pace(self) -> float:
        """What f moves per time and per distance from y [1/s]."""
        Tf, dt = float(self.filter_time or np.inf), self._step()
        return -np.expm1(-dt / Tf) / dt if dt else 1 / Tf

    def _step(self) -> float:
        """The sample time, or 0 in continuous time."""
        system = self._plant[0]
        return float(system.dt or 0) if system.discrete else 0.0

    def _closed(
        self, limit: float | None, state: np.ndarray, d: np.ndarray, t: float
    ) -> np.ndarray:
        n, step = len(self.x0), self._step()
        u, error, rate = self._law(state, limit)
        motion = np.asarray(self._plant[0].rate(state[:n], u + d, t))
        memory = feedback.unwound(error, u, self.gains[1], limit)
        if self.filter_time is not None:
            memory = np.concatenate([memory, rate])
        return np.concatenate([motion, state[n:] + step * memory if step else memory])


def _shown(gain: Any) -> str:
    return f"{gain:g}" if np.ndim(gain) == 0 else str(np.asarray(gain).tolist())
